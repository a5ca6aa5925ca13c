"""Figures on the consistency of an estimate: innovations, their calibration, the error over time, and predictions by dive."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.results.innovations import Measured
from replay_kit.results.plans import thinned
from replay_kit.results.views.contents import Contents
from replay_kit.results.views.slices import (
    Calibration,
    CurrentSlices,
    calibration,
    error_through_time,
    information_by_dive,
)
from replay_kit.show.figures.figure import Axis, Figure, Mark, Panel, missing
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
        return Figure("trust", title, [missing(title, why)])
    figures, lacking = trust_figures(contents)
    panels = [figures[key].panels[k] for key, k in _IN_PRINT.items() if key in figures]
    return Figure("trust", title, panels, notes=lacking)


def trust_figures(contents: Contents) -> tuple[dict[str, Figure], list[str]]:
    """Return the figures on consistency by key, and sentences on missing ones.

    Args:
        contents: Contents of a result with measurements.
    """
    figures, lacking = [_innovations(contents.measured)], []
    found, slices = calibration(contents.measured.innovations), contents.slices
    if found.standardized.size:
        figures.append(_calibration(found, contents.measured))
    if (
        slices is not None
        and slices.time_ns.size > 1
        and np.isfinite(error_through_time(slices)).any()
    ):
        figures.append(_error(slices))
    else:
        lacking.append(
            "Fewer than two grids with a standard error were published: how the error decreased is unknown."
        )
    dives = contents.outcome.by_dive
    if len(dives) > 1:
        figures.append(_dives(contents, dives))
    else:
        lacking.append("Fewer than two dives: none can be predicted from another.")
    return {figure.key: figure for figure in figures}, lacking


def _innovations(measured: Measured) -> Figure:
    """Return the RMS innovation and the NIS of measurements against time, with their expected values."""
    table, bins, count = measured.observations, measured.innovations, measured.count
    variance = sum(_variances(bins, axis, len(table)) for axis in ("east", "north"))
    dof = table["dof"].to_numpy(np.float64)
    each = table.reset_index().assign(
        expected=np.sqrt(_over(variance, dof)), nis=_over(table["nis"].to_numpy(np.float64), dof)
    )
    kept = thinned(len(table), _POINTS)
    shown = each.iloc[kept]
    topics = [rows for _, rows in shown.groupby("source_topic", sort=False)]
    thin = (
        f" {kept.size:,} of {count:,} measurements are drawn, evenly spread."
        if kept.size < count
        else ""
    )
    rms = [*_by_decision(topics, "rms_innovation"), *_expected(topics)]
    nis, axis = [*_by_decision(topics, "nis")], Axis("NIS / dof", from_zero=True)
    return Figure(
        "innovations",
        "Innovations through time",
        [
            Panel("RMS innovation", _TIME, _RMS, rms),
            Panel("normalised innovation squared", _TIME, axis, nis, level=1.0, band=_band(dof)),
        ],
        "First: RMS innovation of each measurement; line: the RMS that the estimate expects. Second: "
        "normalised innovation squared per degree of freedom (NIS/dof); the band holds 95 % of measurements with the "
        f"typical number of bins. Above it errors are understated.{thin}",
        "RMS innovation of each measurement and its normalised innovation squared against time, with their expected values.",
    )


def _band(dof: Array) -> tuple[float, float, str] | None:
    """Return the 95 % interval of the NIS per degree of freedom for correct errors."""
    if not dof.any():
        return None
    typical = float(np.median(dof[dof > 0]))
    # of the root of NIS, whose density is smooth; scipy loads slowly
    step = (np.sqrt(typical) + 8.0) / 4000.0
    root = step * np.arange(0.5, 4000.0)
    logarithm = (typical - 1.0) * np.log(root) - 0.5 * root**2
    share = np.cumsum(np.exp(logarithm - logarithm.max()))
    low, high = (np.interp((0.025, 0.975), share / share[-1], root) + 0.5 * step) ** 2 / typical
    return float(low), float(high), f"95 % of {typical:g} degrees of freedom"


def _over(values: Any, dof: Array) -> Array:
    return np.asarray(np.divide(values, dof, out=np.full(dof.shape, np.nan), where=dof > 0))


def _variances(bins: Any, axis: str, count: int) -> Array:
    """Return the summed variance of a component over the used bins of each measurement, shape (count,) [m^2/s^2]."""
    known = np.isfinite(bins[f"innovation_{axis}"])
    squares = np.where(known, np.nan_to_num(bins[f"innovation_std_{axis}"]) ** 2, 0.0)
    return np.bincount(bins["observation"], squares, minlength=count).astype(np.float64)


def _by_decision(topics: Sequence[Any], name: str) -> Iterator[Mark]:
    """Yield the marks of each topic, given as its rows, and decision."""
    for number, rows in enumerate(topics):
        for decision, color in _DECISIONS.items():
            own = rows[rows["decision"] == decision]
            if len(own):
                label = f"{own['source_topic'].iloc[0]}, {decision}"
                at = own["time"].to_numpy(), own[name].to_numpy(), label
                yield Mark("points", *at, color, _SYMBOLS[number % 4], size=5.0)


def _expected(topics: Sequence[Any]) -> Iterator[Mark]:
    for number, rows in enumerate(topics):
        label = f"{rows['source_topic'].iloc[0]}, expected RMS"
        at = rows["time"].to_numpy(), rows["expected"].to_numpy(), label
        yield Mark("line", *at, "ink", dash=_DASHES[number % 3], width=1.5)


def _calibration(found: Calibration, measured: Measured) -> Figure:
    """Return the histogram of the standardised innovations."""
    edges = np.linspace(-4.0, 4.0, _BINS)
    centre, width = 0.5 * (edges[1:] + edges[:-1]), edges[1] - edges[0]
    counts, _ = np.histogram(np.clip(found.standardized, -4.0, 4.0), edges)
    expected = np.exp(-0.5 * centre**2) / np.sqrt(2.0 * np.pi)
    marks = [
        Mark("bars", centre, counts / (found.standardized.size * width), "found"),
        Mark("line", centre, expected, "expected", "two", width=2.5),
    ]
    one, two = (100.0 * found.coverage[limit] for limit in (1.0, 2.0))
    within = f"{one:.0f} % within 1 (68 %)\n{two:.0f} % within 2 (95 %)"
    mean, count, drawn = fixed(found.mean, 2, True), measured.count, len(measured.observations)
    of = f" of {drawn:,} of {count:,} measurements, evenly spread" if drawn < count else ""
    axis = Axis("innovation / its standard deviation", ends=(-4.0, 4.0))
    note = f"mean {mean}\nstd {found.std:.2f}\n{within}"
    title = "innovations over their standard deviation"
    return Figure(
        "calibration",
        "Innovations against their stated errors",
        [Panel(title, axis, Axis("density", from_zero=True), marks, note=note)],
        f"{found.standardized.size:,} components of the bins used{of}: mean {mean} (expected 0), standard deviation "
        f"{found.std:.2f} (expected 1). A histogram wider than the curve means understated errors; a shifted one, a bias.",
        "Histogram of the standardised innovations with the standard normal curve.",
    )


def _error(slices: CurrentSlices) -> Figure:
    """Return the RMS standard error of the published slices through time."""
    times, errors = slices.time_ns.astype("datetime64[ns]"), error_through_time(slices)
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


def _dives(contents: Contents, dives: Sequence[Mapping[str, Any]]) -> Figure:
    """Return the prediction error and information of each dive of the summary."""
    information = information_by_dive(contents.measured.sums)
    number = np.array([dive["dive"] for dive in dives])
    predicted, prior = (
        np.array([dive[f"rms_innovation_{name}"] for dive in dives], dtype=np.float64)
        for name in ("predicted", "prior")
    )
    rms = [
        Mark("joined", number, predicted, "estimate before the dive"),
        Mark("joined", number, prior, "prior forecast", "two", dash="dash"),
    ]
    axis = Axis("dive", ends=(number[0] - 0.8, number[-1] + 0.8))
    values = np.array([information.get(dive, 0.0) for dive in number.tolist()])
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
