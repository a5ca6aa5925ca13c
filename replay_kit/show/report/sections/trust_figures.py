"""Figures on trust: the spread of the innovations, the fall of the error, each dive predicted from those before it."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy.stats import norm

from replay_kit.results.views.contents import Contents
from replay_kit.results.views.slices import CurrentSlices
from replay_kit.results.views.trust import Calibration, error_through_time, information_by_dive
from replay_kit.show.page.section import Figure, column, times

_BINS = 41
_DIVES_LAYOUT = {
    "height": 480,
    "xaxis": {"title": {"text": "dive"}, "anchor": "y2"},
    "yaxis": {
        "title": {"text": "RMS innovation [m/s]"},
        "domain": [0.45, 1.0],
        "rangemode": "tozero",
    },
    "yaxis2": {"title": {"text": "values"}, "domain": [0.0, 0.34], "rangemode": "tozero"},
}


def calibration_figure(found: Calibration) -> Figure:
    """Return the histogram of the standardised innovations."""
    edges = np.linspace(-4.0, 4.0, _BINS)
    centre, width = 0.5 * (edges[1:] + edges[:-1]), edges[1] - edges[0]
    counts, _ = np.histogram(np.clip(found.standardized, -4.0, 4.0), edges)
    table = {
        "standardized_innovation": column(centre),
        "density": column(counts / (found.standardized.size * width)),
        "expected_density": column(norm.pdf(centre)),
    }
    traces = [
        {
            "type": "bar",
            "name": "found",
            "x": "$calibration.standardized_innovation",
            "y": "$calibration.density",
            "marker": {"color": {"$color": "one"}},
        },
        {
            "type": "scatter",
            "mode": "lines",
            "name": "expected",
            "x": "$calibration.standardized_innovation",
            "y": "$calibration.expected_density",
            "line": {"color": {"$color": "two"}, "width": 2.5},
        },
    ]
    layout = {
        "height": 380,
        "bargap": 0.05,
        "xaxis": {"title": {"text": "innovation / its standard deviation"}},
        "yaxis": {"title": {"text": "density"}},
    }
    caption = (
        f"All {found.standardized.size:,} components of the bins used: mean {found.mean:+.2f}, standard deviation "
        f"{found.std:.2f}; 0 and 1 are expected. "
        "Bars wider than the curve: errors are understated. Bars beside it: a bias. The outermost bars hold everything beyond."
    )
    return Figure(
        "calibration",
        "Innovations against their stated errors",
        caption,
        "Histogram of the standardised innovations beside the standard normal curve.",
        {"calibration": table},
        traces,
        layout,
    )


def error_figure(slices: CurrentSlices) -> Figure:
    """Return the RMS standard error of the published slices through time."""
    errors = error_through_time(slices)
    table: dict[str, Any] = {"time": times(slices.time_ns)}
    traces = []
    for k, depth in enumerate(slices.depths):
        name = f"rms_standard_error_{depth:g}_m"
        table[name] = column(errors[k])
        dash = ("solid", "dash", "dot", "dashdot")[(k // 4) % 4]
        traces.append(
            {
                "type": "scatter",
                "mode": "lines+markers",
                "name": f"{depth:g} m",
                "x": "$error.time",
                "y": table[name],
                "line": {"dash": dash},
            }
        )
    layout = {
        "height": 380,
        "xaxis": {"title": {"text": "time (UTC)"}},
        "yaxis": {"title": {"text": "RMS standard error [m/s]"}, "rangemode": "tozero"},
    }
    caption = (
        "RMS over the region of the standard error of a velocity component. Its fall is the value of the measurements; "
        "where it rises again, the current "
        "changes faster than it is measured."
    )
    return Figure(
        "error",
        "What the measurements took from the error",
        caption,
        "Lines of the region's RMS standard error against time, one for each depth.",
        {"error": table},
        traces,
        layout,
    )


def dives_figure(contents: Contents, dives: Sequence[Mapping[str, Any]]) -> Figure:
    """Return how far each dive lay from its predictions, and what it determined; the dives are those of the summary."""
    information = information_by_dive(contents.result.observations)
    predicted, prior = (
        column(
            [
                np.nan if dive[f"rms_innovation_{name}"] is None else dive[f"rms_innovation_{name}"]
                for dive in dives
            ]
        )
        for name in ("predicted", "prior")
    )
    table = {
        "dive": [dive["dive"] for dive in dives],
        "missed_by_the_estimate_m_s": predicted,
        "missed_by_the_ensemble_m_s": prior,
        "independent_values": column([information.get(dive["dive"], 0.0) for dive in dives]),
    }
    traces = [
        {
            "type": "scatter",
            "mode": "lines+markers",
            "name": name,
            "x": "$dives.dive",
            "y": f"$dives.{key}",
            "line": {"color": {"$color": color}, "dash": dash},
        }
        for name, key, color, dash in (
            ("the estimate before the dive", "missed_by_the_estimate_m_s", "one", "solid"),
            ("the ensemble alone", "missed_by_the_ensemble_m_s", "two", "dash"),
        )
    ]
    bars = {
        "type": "bar",
        "name": "independent values determined",
        "x": "$dives.dive",
        "y": "$dives.independent_values",
        "yaxis": "y2",
        "marker": {"color": {"$color": "three"}},
    }
    caption = (
        "Above: how far each dive's measurements lay from the estimate before the dive, and from the ensemble alone; "
        "the gap between the lines is what the "
        "dives before were worth. Below: how many independent values of the estimate the dive determined."
    )
    return Figure(
        "dives",
        "Each dive predicted from those before it",
        caption,
        "RMS innovation of each dive against the estimate before it and against the ensemble alone.",
        {"dives": table},
        [*traces, bars],
        _DIVES_LAYOUT,
    )
