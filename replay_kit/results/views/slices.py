"""Published estimate on depth slices through time, and the calibration of its stated uncertainty."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.geodesy import inside_grid
from replay_kit.core.grid import Grid
from replay_kit.results.innovations import of_dives
from replay_kit.results.mcap.topics import WINDOW_NAME
from replay_kit.results.plans import thinned
from replay_kit.results.reader import ResultReader
from replay_kit.results.slices import depth_slices, grid_cells, slice_axes

#: Of the fields of a slice, those kept: u, v and their standard errors.
KEPT = ("u", "v", "u_standard_error", "v_standard_error")
_FOLDER = "/flow/grid/"


@dataclass(frozen=True, slots=True, eq=False)
class CurrentSlices:
    """Current on a regular grid of the local frame at some depths and times.

    Attributes:
        depths: shape (D,) [m], increasing.
        time_ns: shape (T,) [ns, UTC], increasing.
        east: shape (I,) [m], cell centres.
        north: shape (J,) [m], cell centres.
        fields: shape (D, T, 4, J, I) [m/s]: u, v along the local axes and their standard errors; NaN where dry or unknown.
        left_out: Number of omitted published times.
        outside: shape (J, I), True for cells off the forecast's grid; other cells without a current are dry. None if the grid is unknown.
    """

    depths: Array
    time_ns: NDArray[np.int64]
    east: Array
    north: Array
    fields: Array
    left_out: int = 0
    outside: NDArray[np.bool_] | None = None


def published_slices(
    reader: ResultReader, grid: Grid | None = None, most_values: int = 1_600_000
) -> CurrentSlices | None:
    """Return the slices in a result; None without any.

    Args:
        reader: Reader of the result.
        grid: Grid of the last estimate, to select one of several windows; None for the first.
        most_values: Largest number of values; intermediate times are omitted to keep it.
    """
    times, depths, windowed = _index(reader)
    if not times or not depths:
        return None
    topics = [f"{_FOLDER}{depth:g}m" for depth in depths]
    east, north = next(_read(reader, topics[:1], {times[0]}))[2:4]
    if windowed:
        east, north = (east, north) if grid is None else slice_axes(grid)
        own = _read(reader, topics[:1], set(times))
        times = sorted({one[0] for one in own if _same(one[2:4], (east, north))})
        if not times:
            return None
    most = max(1, most_values // (len(KEPT) * north.size * east.size * len(depths)))
    kept = [times[k] for k in thinned(len(times), most)]
    fields = np.full((len(depths), len(kept), len(KEPT), north.size, east.size), np.nan)
    for time_ns, depth, *axes, values in _read(reader, topics, set(kept)):
        if not windowed or _same(axes, (east, north)):
            fields[depths.index(depth), kept.index(time_ns)] = values
    return CurrentSlices(
        np.array(depths), np.array(kept), east, north, fields, len(times) - len(kept)
    )


def _same(one: Sequence[Array], other: Sequence[Array]) -> bool:
    """Return whether cell centres are equal to the rounding of a message."""
    pairs = list(zip(one, other, strict=True))
    return all(a.size == b.size and np.allclose(a, b, rtol=1e-9, atol=1e-3) for a, b in pairs)


def slices_of(flow: FlowEstimate, depths: Array) -> CurrentSlices:
    """Return slices of an estimate at its own time at depths [m]."""
    each, time_ns = depth_slices(flow, depths.tolist()), np.array([flow.time_ns or 0])
    found = np.stack([one.fields for one in each])
    fields = np.full((len(each), 1, len(KEPT), *found.shape[2:]), np.nan)
    fields[:, 0, : found.shape[1]] = found
    return on_grid(CurrentSlices(depths, time_ns, each[0].east, each[0].north, fields), flow.grid)


def on_grid(slices: CurrentSlices, grid: Grid) -> CurrentSlices:
    """Return slices with the mask of cells off the forecast's grid; unchanged if another grid has a current there."""
    outside = ~inside_grid(grid, *np.meshgrid(slices.east, slices.north))
    return (
        slices
        if np.isfinite(slices.fields[..., outside]).any()
        else replace(slices, outside=outside)
    )


def _index(reader: ResultReader) -> tuple[list[int], list[float], bool]:
    """Return the times and depths of the slices, both increasing, and whether there are several windows."""
    topics = [topic for topic in reader.topics if topic.startswith(_FOLDER)]
    times = {time_ns for topic in topics for time_ns, _ in reader.messages(topic)}
    found = reader.summary.attachment_indexes
    windowed = any(one.name.startswith(WINDOW_NAME) for one in found)
    depths = (float(topic.removeprefix(_FOLDER).removesuffix("m")) for topic in topics)
    return sorted(times), sorted(depths), windowed


def _read(
    reader: ResultReader, topics: list[str], times: set[int]
) -> Iterator[tuple[int, float, Array, Array, Array]]:
    """Yield time [ns], depth [m], cell centres [m] and fields, shape (4, J, I), of the slices of some times."""
    for topic in topics:
        depth = float(topic.removeprefix(_FOLDER).removesuffix("m"))
        for time_ns, value in reader.decoded(topic):
            if time_ns in times:
                east, north, found = grid_cells(value)
                unknown = np.full((north.size, east.size), np.nan)
                yield time_ns, depth, east, north, np.stack([found.get(k, unknown) for k in KEPT])


#: Standard deviations, and the share of a Gaussian within them.
EXPECTED = {1.0: 0.6827, 2.0: 0.9545, 3.0: 0.9973}


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """Innovations divided by their predicted standard deviations.

    Attributes:
        standardized: shape (n,), values of each component of each used bin.
        coverage: Fraction within a number of standard deviations; empty without values.
        mean: Mean; 0 without bias.
        std: Standard deviation; 1 if the stated errors hold.
    """

    standardized: Array
    coverage: Mapping[float, float]
    mean: float
    std: float


def calibration(bins: pd.DataFrame) -> Calibration:
    """Return the calibration of the innovations.

    Args:
        bins: ``Result.innovations``.
    """
    parts = [
        (bins[f"innovation_{axis}"] / bins[f"innovation_std_{axis}"]).to_numpy(np.float64)
        for axis in ("east", "north")
    ]
    values = np.concatenate(parts)
    values = values[np.isfinite(values)]
    if values.size == 0:
        return Calibration(values, {}, np.nan, np.nan)
    sizes = np.abs(values)
    coverage = {limit: float(np.mean(sizes <= limit)) for limit in EXPECTED}
    return Calibration(values, coverage, float(values.mean()), float(values.std()))


def error_through_time(slices: CurrentSlices) -> Array:
    """Return the RMS standard error of a component over each published slice [m/s], shape (D, T); NaN if unknown."""
    squares = slices.fields[:, :, 2:] ** 2
    known = np.isfinite(squares)
    count = known.sum(axis=(2, 3, 4))
    total = np.where(known, squares, 0.0).sum(axis=(2, 3, 4))
    mean = np.divide(total, count, out=np.full(total.shape, np.nan), where=count > 0)
    return np.asarray(np.sqrt(mean))


def information_by_dive(sums: pd.DataFrame) -> pd.Series:
    """Return the degrees of freedom for signal of the measurements of each dive.

    Args:
        sums: ``Measured.sums``.
    """
    return of_dives(sums).groupby("dive")["signal_dof"].sum()
