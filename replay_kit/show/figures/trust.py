"""Charts on trust: innovations and their spread, the fall of the error, each dive predicted from those before it."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy.stats import chi2, norm

from replay_kit.core.arrays import Array
from replay_kit.results.innovations import Measured
from replay_kit.results.views.contents import Contents
from replay_kit.results.views.slices import (
    Calibration,
    CurrentSlices,
    calibration,
    error_through_time,
    information_by_dive,
)
from replay_kit.results.views.track import thinned
from replay_kit.show.figures.values import Axis, Chart, Mark, Panel
from replay_kit.show.numbers import fixed

_TIME = Axis("time (UTC)")
_RMS = Axis("RMS innovation", "m/s", from_zero=True)
_POINTS, _BINS = 3000, 41
_SYMBOLS = ("circle", "diamond", "square", "triangle-up")
_DASHES = ("solid", "dash", "dot", "dashdot")
_COLORS = ("one", "two", "three", "four")
_DECISIONS = {"accepted": "one", "softened": "two", "rejected": "four", "unusable": "three"}


def trust_charts(contents: Contents) -> tuple[dict[str, Chart], list[str]]:
    """Return the charts on trust by key, and what the result lacks for others, as sentences.

    Args:
        contents: Of a result with measurements.
    """
    charts, missing = [innovations_chart(contents)], []
    found, slices = calibration(contents.measured.innovations), contents.slices
    if found.standardized.size:
        charts.append(calibration_chart(found, contents.measured))
    if (
        slices is not None
        and slices.time_ns.size > 1
        and np.isfinite(error_through_time(slices)).any()
    ):
        charts.append(error_chart(slices))
    else:
        missing.append(
            "Fewer than two grids with a standard error were published: how the error decreased is unknown."
        )
    dives = contents.outcome.by_dive
    if len(dives) > 1:
        charts.append(dives_chart(contents, dives))
    else:
        missing.append("Fewer than two dives: none can be predicted from another.")
    return {chart.key: chart for chart in charts}, missing


def innovations_chart(contents: Contents) -> Chart:
    """Return the RMS innovation of each measurement and its normalised square through time, with what is expected of them."""
    count = contents.measured.count
    table, bins = contents.measured.observations, contents.measured.innovations
    variance = sum(_variances(bins, axis, len(table)) for axis in ("east", "north"))
    dof = table["dof"].to_numpy(np.float64)
    each = {
        "rms_innovation_m_s": table["rms_innovation"].to_numpy(np.float64),
        "expected_rms_m_s": np.sqrt(_over(variance, dof)),
        "rms_residual_m_s": table["rms_residual"].to_numpy(np.float64),
        "nis_per_dof": _over(table["nis"].to_numpy(np.float64), dof),
    }
    kept = thinned(len(table), _POINTS)
    shown = table.iloc[kept]
    data: dict[str, Any] = {
        "time": shown.index.to_numpy(),
        "dive": shown["dive"].to_numpy(),
        "topic": shown["source_topic"].to_numpy(str),
        "decision": shown["decision"].to_numpy(str),
        **{name: values[kept] for name, values in each.items()},
        "dof": shown["dof"].to_numpy(),
    }
    typical, band = (float(np.median(dof[dof > 0])) if dof.any() else 0.0), None
    if typical:
        low, high = (float(chi2.ppf(share, typical) / typical) for share in (0.025, 0.975))
        band = low, high, f"95 % of {typical:g} degrees of freedom"
    thin = (
        f" {kept.size:,} of {count:,} measurements are drawn, evenly spread."
        if kept.size < count
        else ""
    )
    return Chart(
        "innovations",
        "Innovations through time",
        _TIME,
        [
            Panel("RMS innovation", _RMS, _innovation_marks(data)),
            Panel(
                "normalised innovation squared",
                Axis("NIS / dof", from_zero=True),
                _decision_marks(data, "nis_per_dof"),
                1.0,
                band,
            ),
        ],
        "Top: RMS innovation of each measurement; the line is the RMS that the estimate expects. Bottom: "
        "normalised innovation squared per degree of freedom (NIS/dof); the band holds 95 % of measurements with the "
        f"typical number of bins. Points that stay above the band mean that errors are understated.{thin}",
        "RMS innovation of each measurement and its normalised innovation squared against time, with their expected values.",
        {"innovations": data},
        520,
    )


def _over(values: Any, dof: Array) -> Array:
    return np.asarray(np.divide(values, dof, out=np.full(dof.shape, np.nan), where=dof > 0))


def _variances(bins: Any, axis: str, count: int) -> Array:
    """Return for each of ``count`` measurements the sum of a component's variances over its bins used [m^2/s^2], shape (count,)."""
    squares = np.where(
        np.isfinite(bins[f"innovation_{axis}"]),
        np.nan_to_num(bins[f"innovation_std_{axis}"]) ** 2,
        0.0,
    )
    return np.bincount(bins["observation"], squares, minlength=count).astype(np.float64)


def _decision_marks(data: dict[str, Any], name: str) -> list[Mark]:
    """Return the points of each topic and decision."""
    marks = []
    for number, topic in enumerate(dict.fromkeys(data["topic"].tolist())):
        for decision, color in _DECISIONS.items():
            here = (data["topic"] == topic) & (data["decision"] == decision)
            if here.any():
                look: Any = {"color": color, "symbol": _SYMBOLS[number % 4], "size": 5}
                label = f"{topic}, {decision}"
                marks.append(Mark("points", data["time"][here], data[name][here], label, **look))
    return marks


def _innovation_marks(data: dict[str, Any]) -> list[Mark]:
    marks = _decision_marks(data, "rms_innovation_m_s")
    for number, topic in enumerate(dict.fromkeys(data["topic"].tolist())):
        here, dash = data["topic"] == topic, _DASHES[number % 3]
        expected = data["time"][here], data["expected_rms_m_s"][here]
        marks.append(Mark("line", *expected, f"{topic}, expected RMS", "ink", dash=dash, width=1.5))
    return marks


def calibration_chart(found: Calibration, measured: Measured) -> Chart:
    """Return the histogram of the standardised innovations."""
    edges = np.linspace(-4.0, 4.0, _BINS)
    centre, width = 0.5 * (edges[1:] + edges[:-1]), edges[1] - edges[0]
    counts, _ = np.histogram(np.clip(found.standardized, -4.0, 4.0), edges)
    table = {
        "standardized_innovation": centre,
        "density": counts / (found.standardized.size * width),
        "expected_density": norm.pdf(centre),
    }
    x = "calibration.standardized_innovation"
    marks = [
        Mark("bars", x, "calibration.density", "found"),
        Mark("line", x, "calibration.expected_density", "expected", "two", width=2.5),
    ]
    within = f"{100.0 * found.coverage[1.0]:.0f} % within 1 (68 %)\n{100.0 * found.coverage[2.0]:.0f} % within 2 (95 %)"
    mean = fixed(found.mean, 2, True)
    count, drawn = measured.count, len(measured.observations)
    of = f" of {drawn:,} of {count:,} measurements, evenly spread" if drawn < count else ""
    note = f"mean {mean}\nstd {found.std:.2f}\n{within}"
    return Chart(
        "calibration",
        "Innovations against their stated errors",
        Axis("innovation / its standard deviation", ends=(-4.0, 4.0)),
        [Panel("innovations over their standard deviation", Axis("density"), marks, note=note)],
        f"{found.standardized.size:,} components of the bins used{of}: mean {mean} (expected 0), standard deviation "
        f"{found.std:.2f} (expected 1). A histogram wider than the curve means understated errors; a shifted one, a bias. "
        "The outermost bars include all values beyond.",
        "Histogram of the standardised innovations beside the standard normal curve.",
        {"calibration": table},
    )


def error_chart(slices: CurrentSlices) -> Chart:
    """Return the RMS standard error of the published slices through time."""
    errors = error_through_time(slices)
    names = [f"rms_standard_error_{depth:g}_m" for depth in slices.depths]
    table = {
        "time": slices.time_ns.astype("datetime64[ns]"),
        **dict(zip(names, errors, strict=True)),
    }
    marks = [
        Mark(
            "joined",
            "error.time",
            f"error.{name}",
            f"{depth:g} m",
            _COLORS[k % 4],
            dash=_DASHES[(k + k // 4) % 4],
        )
        for k, (name, depth) in enumerate(zip(names, slices.depths, strict=True))
    ]
    axis = Axis("RMS standard error", "m/s", from_zero=True)
    return Chart(
        "error",
        "Standard error through time",
        _TIME,
        [Panel("RMS standard error of the region", axis, marks)],
        "Standard error of a velocity component, RMS over the region. It falls as measurements come in, and rises where "
        "the current changes faster than it is measured.",
        "Lines of the region's RMS standard error against time, one for each depth.",
        {"error": table},
    )


def dives_chart(contents: Contents, dives: Sequence[Mapping[str, Any]]) -> Chart:
    """Return how far each dive lay from its predictions, and what it determined; the dives are those of the summary."""
    information = information_by_dive(contents.measured.sums)
    predicted, prior = (
        np.array([dive[f"rms_innovation_{name}"] for dive in dives], dtype=np.float64)
        for name in ("predicted", "prior")
    )
    table = {
        "dive": np.array([dive["dive"] for dive in dives]),
        "missed_by_the_estimate_m_s": predicted,
        "missed_by_the_ensemble_m_s": prior,
        "independent_values": np.array([information.get(dive["dive"], 0.0) for dive in dives]),
    }
    rms = [
        Mark(
            "joined", "dives.dive", "dives.missed_by_the_estimate_m_s", "estimate before the dive"
        ),
        Mark(
            "joined",
            "dives.dive",
            "dives.missed_by_the_ensemble_m_s",
            "prior forecast",
            "two",
            dash="dash",
        ),
    ]
    bars = Mark(
        "bars", "dives.dive", "dives.independent_values", "independent values determined", "three"
    )
    return Chart(
        "dives",
        "Each dive predicted from those before it",
        Axis("dive"),
        [
            Panel("RMS innovation of each dive", _RMS, rms, share=1.6),
            Panel("information of each dive", Axis("values", from_zero=True), [bars]),
        ],
        "Top: RMS innovation of each dive against the estimate before it and against the prior forecast; the gap between the "
        "lines is the value of the earlier dives. Bottom: number of independent values of the estimate that the dive determined.",
        "RMS innovation of each dive against the estimate before it and against the prior forecast.",
        {"dives": table},
        480,
    )
