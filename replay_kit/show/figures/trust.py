"""Figures on the consistency of an estimate: innovations, their calibration, the error over time, and predictions by dive."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from replay_kit.core.arrays import Array
from replay_kit.results.innovations import Measured, rows_of_dives, thinned
from replay_kit.results.views.contents import Contents
from replay_kit.results.views.current import CurrentSlices, error_through_time
from replay_kit.show.figures.figure import Axis, Figure, Mark, Panel, missing_panel
from replay_kit.show.numbers import fixed

_TIME = Axis("time (UTC)")
_RMS = Axis("RMS innovation", "m/s", from_zero=True)
_POINTS, _BINS = 1500, 41
_SYMBOLS = ("circle", "diamond", "square", "triangle-up")
_DASHES = ("solid", "dash", "dot", "dashdot")
_COLORS = ("one", "two", "three", "four")
_DECISIONS = {"accepted": "one", "softened": "two", "rejected": "four", "unusable": "three"}
# Of each figure the panel that a paper needs.
_IN_PRINT = {"dives": 0, "innovations": 1, "calibration": 0, "error": 0}


def trust_figure(contents: Contents) -> Figure:
    """Return the figures on the consistency of the estimate as one."""
    title = "Innovations"
    if not contents.measured.count:
        why = "The result holds no measurement to compare the estimate with."
        return Figure("trust", title, [missing_panel(title, why)])
    figures, lacking = trust_figures(contents)
    panels = [figures[key].panels[k] for key, k in _IN_PRINT.items() if key in figures]
    return Figure("trust", title, panels, notes=lacking)


def trust_figures(contents: Contents) -> tuple[dict[str, Figure], list[str]]:
    """Return the figures on consistency by key, and sentences on missing ones.

    Args:
        contents: Contents of a result with measurements.
    """
    measured, slices, dives = contents.measured, contents.slices, contents.outcome.by_dive
    figures, lacking = [_innovations(measured)], []
    values = standardized(measured.innovations)
    if values.size:
        figures.append(_calibration(values, measured))
    errors = np.empty(0) if slices is None else error_through_time(slices)
    if slices is not None and slices.time_ns.size > 1 and np.isfinite(errors).any():
        figures.append(_error(slices, errors))
    else:
        lacking.append(
            "Fewer than two grids with a standard error were published: how the error decreased is unknown."
        )
    if len(dives) > 1:
        figures.append(_dives(measured, dives))
    else:
        lacking.append("Fewer than two dives: none can be predicted from another.")
    return {figure.key: figure for figure in figures}, lacking


def _innovations(measured: Measured) -> Figure:
    """Return the RMS innovation and the NIS of measurements against time, with their expected values."""
    table, bins = measured.observations.reset_index(), measured.innovations
    # of the used bins of each measurement
    squares = sum(
        (bins[f"innovation_std_{end}"] ** 2).where(bins[f"innovation_{end}"].notna(), 0.0)
        for end in ("east", "north")
    ).astype(np.float64)
    variance = squares.groupby(bins["observation"]).sum().reindex(table.index, fill_value=0.0)
    dof = table["dof"].where(table["dof"] > 0)
    kept = thinned(len(table), _POINTS)
    each = table.assign(expected=np.sqrt(variance / dof), nis=table["nis"] / dof).iloc[kept]
    panels: dict[str, list[Mark]] = {"rms_innovation": [], "nis": []}
    for number, (topic, rows) in enumerate(each.groupby("source_topic", sort=False)):
        for name, marks in panels.items():
            for decision, color in _DECISIONS.items():
                some = rows[rows["decision"] == decision]
                if len(some):
                    at = some["time"].to_numpy(), some[name].to_numpy(), f"{topic}, {decision}"
                    marks.append(Mark("points", *at, color, _SYMBOLS[number % 4], size=5.0))
    for number, (topic, rows) in enumerate(each.groupby("source_topic", sort=False)):
        at = rows["time"].to_numpy(), rows["expected"].to_numpy(), f"{topic}, expected RMS"
        line = Mark("line", *at, "ink", dash=_DASHES[number % 3], width=1.5)
        panels["rms_innovation"].append(line)
    drawn = f" {kept.size:,} of {measured.count:,} measurements are drawn, evenly spread."
    rms, nis = panels.values()
    band, axis = _band(dof.dropna().to_numpy()), Axis("NIS / dof", from_zero=True)
    return Figure(
        "innovations",
        "Innovations through time",
        [
            Panel("RMS innovation", _TIME, _RMS, rms),
            Panel("normalised innovation squared", _TIME, axis, nis, level=1.0, band=band),
        ],
        "First: RMS innovation of each measurement; line: the RMS that the estimate expects. Second: "
        "normalised innovation squared per degree of freedom (NIS/dof); the band holds 95 % of measurements with the "
        f"typical number of bins. Above it errors are understated.{drawn if kept.size < measured.count else ''}",
        "RMS innovation of each measurement and its normalised innovation squared against time, with their expected values.",
    )


def _band(dof: Array) -> tuple[float, float, str] | None:
    """Return the 95 % interval of the NIS per degree of freedom for correct errors; None without degrees of freedom."""
    if not dof.size:
        return None
    typical = float(np.median(dof))
    # of the root of NIS, whose density is smooth; scipy loads slowly
    step = (np.sqrt(typical) + 8.0) / 4000.0
    root = step * np.arange(0.5, 4000.0)
    logarithm = (typical - 1.0) * np.log(root) - 0.5 * root**2
    share = np.cumsum(np.exp(logarithm - logarithm.max()))
    low, high = (np.interp((0.025, 0.975), share / share[-1], root) + 0.5 * step) ** 2 / typical
    return float(low), float(high), f"95 % of {typical:g} degrees of freedom"


def standardized(bins: pd.DataFrame) -> Array:
    """Return the components of the innovations of used bins over their predicted standard deviations, shape (n,).

    Args:
        bins: ``Result.innovations``.
    """
    parts = [bins[f"innovation_{end}"] / bins[f"innovation_std_{end}"] for end in ("east", "north")]
    values = np.concatenate(parts).astype(np.float64)
    return values[np.isfinite(values)]


def _calibration(values: Array, measured: Measured) -> Figure:
    """Return the histogram of the standardised innovations."""
    edges = np.linspace(-4.0, 4.0, _BINS)
    centre, width = 0.5 * (edges[1:] + edges[:-1]), edges[1] - edges[0]
    counts, _ = np.histogram(np.clip(values, -4.0, 4.0), edges)
    expected = np.exp(-0.5 * centre**2) / np.sqrt(2.0 * np.pi)
    marks = [
        Mark("bars", centre, counts / (values.size * width), "found"),
        Mark("line", centre, expected, "expected", "two", width=2.5),
    ]
    one, two = (100.0 * np.mean(np.abs(values) <= limit) for limit in (1.0, 2.0))
    mean, std = fixed(float(values.mean()), 2, True), f"{values.std():.2f}"
    drawn, count = len(measured.observations), measured.count
    part = f" of {drawn:,} of {count:,} measurements, evenly spread" if drawn < count else ""
    axis = Axis("innovation / its standard deviation", ends=(-4.0, 4.0))
    note = f"mean {mean}\nstd {std}\n{one:.0f} % within 1 (68 %)\n{two:.0f} % within 2 (95 %)"
    title = "innovations over their standard deviation"
    return Figure(
        "calibration",
        "Innovations against their stated errors",
        [Panel(title, axis, Axis("density", from_zero=True), marks, note=note)],
        f"{values.size:,} components of used bins{part}: mean {mean} (expected 0), standard deviation "
        f"{std} (expected 1). A histogram wider than the curve means understated errors; a shifted one, a bias.",
        "Histogram of the standardised innovations with the standard normal curve.",
    )


def _error(slices: CurrentSlices, errors: Array) -> Figure:
    """Return the RMS standard error of the published slices through time."""
    times = slices.time_ns.astype("datetime64[ns]")
    marks = [
        Mark("joined", times, error, f"{depth:g} m", _COLORS[k % 4], dash=_DASHES[(k + k // 4) % 4])
        for k, (error, depth) in enumerate(zip(errors, slices.depths, strict=True))
    ]
    axis = Axis("RMS standard error", "m/s", from_zero=True)
    return Figure(
        "error",
        "Standard error through time",
        [Panel("RMS standard error of the region", _TIME, axis, marks)],
        "Standard error of a velocity component, RMS over the region. It falls as measurements come in, and rises where "
        "the current changes faster than it is measured.",
        "Lines of the region's RMS standard error against time, one for each depth.",
    )


def _dives(measured: Measured, dives: Sequence[Mapping[str, Any]]) -> Figure:
    """Return the prediction error and information of each dive of the summary."""
    rows = pd.DataFrame(dives).set_index("dive")
    number = rows.index.to_numpy()
    predicted, prior = (
        rows[f"rms_innovation_{name}"].to_numpy(np.float64) for name in ("predicted", "prior")
    )
    rms = [
        Mark("joined", number, predicted, "estimate before the dive"),
        Mark("joined", number, prior, "prior forecast", "two", dash="dash"),
    ]
    axis = Axis("dive", ends=(number[0] - 0.8, number[-1] + 0.8))
    known = rows_of_dives(measured.sums).groupby("dive")["signal_dof"].sum()
    values = known.reindex(number, fill_value=0.0).to_numpy()
    bars = Mark("bars", number, values, "independent values determined", "three")
    return Figure(
        "dives",
        "Each dive predicted from those before it",
        [
            Panel("RMS innovation of each dive", axis, _RMS, rms),
            Panel("information of each dive", axis, Axis("values", from_zero=True), [bars]),
        ],
        "First: RMS innovation of each dive against the estimate before it and against the prior forecast; the gap between the "
        "lines is the value of the earlier dives. Second: number of independent values of the estimate that the dive determined.",
        "RMS innovation of each dive against the estimate before it and against the prior forecast.",
    )
