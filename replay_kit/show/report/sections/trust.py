"""Whether the answer can be trusted: innovations, their spread against the stated errors, the error's decrease, the gate."""

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from replay_kit.core.arrays import Array
from replay_kit.results.views.contents import Contents
from replay_kit.results.views.track import thinned
from replay_kit.results.views.trust import (
    EXPECTED,
    Calibration,
    calibration,
    error_through_time,
    information_by_dive,
)
from replay_kit.show.page.section import Figure, Section, cm, column, number, table_html
from replay_kit.show.report.sections.surfacings import surfacings_html
from replay_kit.show.report.sections.trust_figures import (
    calibration_figure,
    dives_figure,
    error_figure,
)
from replay_kit.show.words import evidence_sentence, referee_sentences

_POINTS = 3000
_SYMBOLS = ("circle", "diamond", "square", "triangle-up")
_DECISIONS = {"accepted": "one", "softened": "two", "rejected": "four", "unusable": "three"}


def trust_section(contents: Contents) -> Section:
    """Return innovations, calibration, the decrease of the error and the decisions of the gate."""
    result, slices = contents.result, contents.slices
    if not len(result.observations):
        return Section(
            "trust",
            "Trust",
            missing=[
                "The result holds no measurement: there is nothing to compare the estimate with."
            ],
        )
    found, missing = calibration(result.innovations), []
    figures = [_innovations(contents)]
    if found.standardized.size:
        figures.append(calibration_figure(found))
    if (
        slices is not None
        and slices.time_ns.size > 1
        and np.isfinite(error_through_time(slices)).any()
    ):
        figures.append(error_figure(slices))
    else:
        missing.append(
            "Fewer than two published grids with a standard error: how it decreased is not known."
        )
    dives = contents.outcome.by_dive
    if len(dives) > 1:
        figures.append(dives_figure(contents, dives))
    surfacings = _evidence_html(contents) + surfacings_html(contents.outcome.expected_surfacings)
    return Section(
        "trust",
        "Trust",
        _coverage_html(found) + _gate_html(contents) + _dives_html(contents, dives) + surfacings,
        figures,
        missing,
    )


def _coverage_html(found: Calibration) -> str:
    if not found.coverage:
        return ""
    rows = [
        [f"{limit:g}", f"{100 * EXPECTED[limit]:.1f} %", f"{100 * share:.1f} %"]
        for limit, share in found.coverage.items()
    ]
    return table_html(
        ["standard deviations", "expected", "found"],
        rows,
        "Share of the innovations within the stated errors",
    )


def _gate_html(contents: Contents) -> str:
    table = contents.result.observations
    rows = [
        [escape(name), f"{count:,}"]
        for name, count in table["decision"].value_counts().sort_index().items()
    ]
    inflated = int((table["prior_inflation"] > 1.0).sum())
    text = (
        f"<p>The estimate's covariance was inflated {inflated} times because the latest measurements lay outside it.</p>"
        if inflated
        else ""
    )
    notes = [note for note in contents.outcome.notes if "bias" in note]
    biases = "".join(f"<p>{escape(note)}.</p>" for note in notes)
    return (
        table_html(
            ["decision of the gate", "measurements"], rows, "What was done with the measurements"
        )
        + text
        + biases
    )


def _evidence_html(contents: Contents) -> str:
    """Return the log evidence of the run, and of the forecasts that it was compared with, in words."""
    found, compared = contents.outcome.evidence, contents.outcome.referee
    if not found:
        return ""
    sentences = [
        f"Log evidence: {evidence_sentence(found)}",
        *(referee_sentences(compared) if compared else ()),
    ]
    return "".join(f"<p>{escape(sentence)}.</p>" for sentence in sentences)


def _dives_html(contents: Contents, dives: Sequence[Mapping[str, Any]]) -> str:
    if not dives:
        return "<p>The log has no dives with measurements to compare.</p>"
    information = information_by_dive(contents.result.observations)
    rows = []
    for k, dive in enumerate(dives):
        key = f"by_dive.{k}"
        nis = dive["nis_per_dof"]
        rows.append(
            [
                number(f"{key}.dive", dive["dive"], str(dive["dive"])),
                number(f"{key}.profiles", dive["profiles"], str(dive["profiles"])),
                number(f"{key}.bins", dive["bins"], str(dive["bins"])),
                cm(f"{key}.rms_innovation_predicted", dive["rms_innovation_predicted"]),
                cm(f"{key}.rms_innovation_prior", dive["rms_innovation_prior"]),
                number(f"{key}.nis_per_dof", nis, "" if nis is None else f"{nis:.2f}"),
                f"{information.get(dive['dive'], 0.0):.1f}",
            ]
        )
    heads = [
        "dive",
        "profiles",
        "bins",
        "missed by the estimate before it",
        "missed by the ensemble alone",
        "NIS/dof",
        "independent values determined",
    ]
    return table_html(
        heads, rows, "The dives: each predicted from the dives before it, and what it added"
    )


def _variances(bins: Any, axis: str, count: int) -> Array:
    """Return for each of ``count`` measurements the sum of a component's variances over its bins used [m^2/s^2], shape (count,)."""
    squares = np.where(
        np.isfinite(bins[f"innovation_{axis}"]),
        np.nan_to_num(bins[f"innovation_std_{axis}"]) ** 2,
        0.0,
    )
    return np.bincount(bins["observation"], squares, minlength=count).astype(np.float64)


def _innovations(contents: Contents) -> Figure:
    table, bins = contents.result.observations, contents.result.innovations
    kept = thinned(len(table), _POINTS)
    per = sum(_variances(bins, axis, len(table)) for axis in ("east", "north"))
    dof = table["dof"].to_numpy(np.float64)
    expected = np.sqrt(np.divide(per, dof, out=np.full(dof.shape, np.nan), where=dof > 0))
    nis = np.divide(
        table["nis"].to_numpy(np.float64), dof, out=np.full(dof.shape, np.nan), where=dof > 0
    )
    shown = table.iloc[kept]
    data: dict[str, Any] = {
        "time": [str(time)[:19] for time in shown.index],
        "dive": shown["dive"].tolist(),
        "topic": shown["source_topic"].tolist(),
        "decision": shown["decision"].tolist(),
        "rms_innovation_m_s": column(shown["rms_innovation"]),
        "expected_rms_m_s": column(expected[kept]),
        "rms_residual_m_s": column(shown["rms_residual"]),
        "nis_per_dof": column(nis[kept]),
        "dof": shown["dof"].tolist(),
    }
    traces = _innovation_traces(data)
    layout = {
        "height": 520,
        "xaxis": {"title": {"text": "time (UTC)"}, "anchor": "y2"},
        "yaxis": {
            "title": {"text": "RMS innovation [m/s]"},
            "domain": [0.54, 1.0],
            "rangemode": "tozero",
        },
        "yaxis2": {"title": {"text": "NIS / dof"}, "domain": [0.0, 0.46], "rangemode": "tozero"},
        "shapes": _band(dof[dof > 0]),
    }
    count = len(table)
    caption = (
        "Above: RMS of each measurement's innovations, with the RMS that the estimate expects as a line. Below: "
        "normalised innovation squared per "
        "degree of freedom, with the band in which 95 % should lie of measurements with the typical number of bins. "
        "Points above the band again and again mean that errors "
        "are understated."
        + (
            f" Of {count:,} measurements {_POINTS:,} are drawn, evenly spread."
            if count > _POINTS
            else ""
        )
    )
    return Figure(
        "innovations",
        "Innovations through time",
        caption,
        "RMS innovation of each measurement and its normalised innovation squared against time, with what is expected of them.",
        {"innovations": data},
        traces,
        layout,
    )


def _innovation_traces(data: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the points of each topic and decision in both panels, and the expected RMS of each topic."""
    decisions, topics = np.array(data["decision"]), np.array(data["topic"])
    traces: list[dict[str, Any]] = []

    def picked(column_name: str, here: NDArray[np.intp]) -> list[Any]:
        return [data[column_name][k] for k in here]

    for number_of, topic in enumerate(dict.fromkeys(data["topic"])):
        for name, color in _DECISIONS.items():
            here = np.flatnonzero((decisions == name) & (topics == topic))
            if here.size:
                marker = {
                    "color": {"$color": color},
                    "size": 5,
                    "symbol": _SYMBOLS[number_of % len(_SYMBOLS)],
                }
                group = f"{topic}, {name}"
                common = {
                    "type": "scatter",
                    "mode": "markers",
                    "name": group,
                    "legendgroup": group,
                    "marker": marker,
                    "x": picked("time", here),
                }
                traces.append({**common, "y": picked("rms_innovation_m_s", here)})
                traces.append(
                    {**common, "y": picked("nis_per_dof", here), "yaxis": "y2", "showlegend": False}
                )
        here = np.flatnonzero(topics == topic)
        line = {
            "color": {"$color": "ink"},
            "width": 1.5,
            "dash": ("solid", "dash", "dot")[number_of % 3],
        }
        expected = {"x": picked("time", here), "y": picked("expected_rms_m_s", here), "line": line}
        traces.append(
            {"type": "scatter", "mode": "lines", "name": f"{topic}, expected RMS", **expected}
        )
    return traces


def _band(dof: Array) -> Sequence[Mapping[str, Any]]:
    """Return the 95 % band of NIS over its degrees of freedom, of the median measurement, and a line at 1."""
    if dof.size == 0:
        return []
    typical = float(np.median(dof))
    low, high = (float(chi2.ppf(share, typical) / typical) for share in (0.025, 0.975))
    across = {"xref": "paper", "x0": 0, "x1": 1, "yref": "y2"}
    band = {
        **across,
        "type": "rect",
        "y0": low,
        "y1": high,
        "fillcolor": {"$color": "three"},
        "opacity": 0.18,
        "line": {"width": 0},
        "layer": "below",
    }
    return [
        band,
        {
            **across,
            "type": "line",
            "y0": 1,
            "y1": 1,
            "line": {"color": {"$color": "soft"}, "width": 1, "dash": "dot"},
        },
    ]
