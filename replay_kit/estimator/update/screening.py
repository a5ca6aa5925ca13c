"""Screening: which bins of a measurement an estimator of a region can use, and the innovation of a measurement that is not used."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array, replace
from replay_kit.core.geodesy import inside_grid, rotate_to_local, to_local
from replay_kit.core.grid import Grid, Projection
from replay_kit.core.observation import (
    BOTH_COMPONENTS,
    Flag,
    Innovation,
    LinearMeasurement,
    Measurement,
    PathMean,
    Reason,
    usable,
)
from replay_kit.estimator.update.grouping import mean_longitude


def screen(
    observations: Sequence[Measurement], grid: Grid, relative: bool = True
) -> tuple[NDArray[np.int8], NDArray[np.int32]]:
    """Return flags and reasons of measurements' values after the region's own checks, shapes (n, m).

    Args:
        observations: With as many values each.
        grid: The region.
        relative: Whether a profile relative to a platform of unknown velocity can be used.
    """
    measurements = [each.linear for each in observations]
    flags, reasons, depth, value, error_std = (
        np.array([getattr(each, name) for each in measurements])
        for name in ("flags", "reasons", "value_depth", "value", "error_std")
    )
    (first, *others) = measurements
    spread = not (others or first.at_one_place)
    places = first.value_places if spread else _places(measurements)
    # shapes (n, 1), or (1, m) of one measurement whose values have places of their own
    east, north = (
        each[None] if spread else each[:, None] for each in to_local(grid.projection, *places)
    )
    outside = np.broadcast_to(~inside_grid(grid, east, north), flags.shape)
    dry = ~outside & (False if grid.wet.all() else ~_is_wet(grid, depth, east, north))
    wrong = ~np.isfinite(value).all(axis=2) | ~(error_std > 0.0) | ~np.isfinite(error_std)
    for failed, reason in (
        (depth > grid.levels[-1], Reason.BELOW_GRID),
        (outside, Reason.OUTSIDE_REGION),
        (dry, Reason.ON_LAND),
        (wrong & usable(flags), Reason.MALFORMED),
    ):
        reasons[failed] |= reason
        flags[failed & usable(flags)] = Flag.FAIL
    # relative to a platform of unknown velocity only differences between bins are known, and one bin has none
    unknown = np.array([not np.isfinite(each.common_std) for each in measurements])
    alone = unknown & ((np.count_nonzero(usable(flags), axis=1) < 2) | (not relative))
    reasons[alone] |= np.int32(Reason.PLATFORM_REFERENCE)
    flags[alone[:, None] & usable(flags)] = Flag.FAIL
    return flags, reasons


def _is_wet(grid: Grid, depth: Array, east: Array, north: Array) -> NDArray[np.bool_]:
    """Return whether values, shape (n, m), lie in the forecast's water: the level nearest in depth decides, at the nearest grid point."""
    level = np.argmin(np.abs(depth[..., None] - grid.levels), axis=-1)
    nearest = np.argmin(
        (grid.east.ravel() - east[..., None]) ** 2 + (grid.north.ravel() - north[..., None]) ** 2,
        axis=-1,
    )
    return np.asarray(grid.wet.reshape(grid.levels.size, -1)[level, nearest])


# Not slotted: what is asked for again and again is kept.
@dataclass(frozen=True, eq=False)
class ScreenedGroup:
    """Measurements with as many values each, after screening.

    Attributes:
        events: In order.
        linear: The same as estimators see them.
        flags: shape (n, m).
        reasons: shape (n, m).
        rejected: Those that are not used although they have usable values, and why.
        used: Positions of those that are used.
        projection: Of the region.
    """

    events: tuple[Measurement, ...]
    linear: tuple[LinearMeasurement, ...]
    flags: NDArray[np.int8]
    reasons: NDArray[np.int32]
    rejected: Mapping[int, Reason]
    used: NDArray[np.intp]
    projection: Projection

    @cached_property
    def usable_linear(self) -> tuple[LinearMeasurement, ...]:
        """Those that are used."""
        return tuple(self.linear[i] for i in self.used)

    @cached_property
    def is_used(self) -> NDArray[np.bool_]:
        """Which of their values are used, shape (n, m)."""
        return usable(self.flags[self.used])

    @property
    def middle(self) -> tuple[float, float]:
        """Mean longitude and latitude of those that are used [degrees]."""
        longitude, latitude = _places(self.usable_linear)
        return mean_longitude(longitude), float(latitude.mean())

    def measured(self, levels: Array) -> NDArray[np.bool_]:
        """Return the levels nearest to the values that are used, and those between them, shape (Z,); ``levels`` alike [m]."""
        depth = np.array([each.value_depth for each in self.usable_linear])[self.is_used]
        first, last = (np.abs(levels - end).argmin() for end in (depth.min(), depth.max()))
        at = np.arange(levels.size)
        return np.asarray((at >= first) & (at <= last))

    def unused(self, i: int) -> Innovation:
        """Return the innovation of a measurement that is not used."""
        linear, flags, reasons = self.linear[i], self.flags[i], self.reasons[i]
        blank = _with_mean_current(
            unused_innovation(linear, flags, reasons), linear, self.projection
        )
        if i not in self.rejected:
            return blank
        failed = np.where(usable(flags), Flag.FAIL, flags).astype(np.int8)
        reasons = reasons | np.int32(self.rejected[i])
        return replace(blank, flags=failed, reasons=reasons, decision="rejected")


def screen_group(
    events: Sequence[Measurement],
    last: LinearMeasurement | None,
    grid: Grid,
    late: bool = False,
    relative: bool = True,
) -> ScreenedGroup:
    """Return measurements after screening.

    Args:
        events: With as many values each.
        last: The last measurement with a usable value before them; an equal one that follows is a duplicate.
        grid: The region.
        late: Whether they are too old for the estimate.
        relative: As of ``screen``.
    """
    (group,) = screen_groups([events], last, grid, [late], relative)
    return group


def screen_groups(
    groups: Sequence[Sequence[Measurement]],
    last: LinearMeasurement | None,
    grid: Grid,
    late: Sequence[bool],
    relative: bool = True,
) -> Iterator[ScreenedGroup]:
    """Yield groups of measurements after screening, one after another; those of as many values together.

    Args:
        groups: As of ``screen_group``.
        last: Alike, before the first.
        grid: The region.
        late: Of each group.
        relative: As of ``screen``.
    """
    linear = [tuple(each.linear for each in events) for events in groups]

    def alike(number: int) -> tuple[int, int]:
        first = linear[number][0]
        return first.flags.size, -1 if first.at_one_place else number

    for _, numbers in groupby(range(len(groups)), alike):
        some = list(numbers)
        together = [each for number in some for each in linear[number]]
        flags, reasons = screen(together, grid, relative)
        start = 0
        for number in some:
            own = slice(start, start + len(linear[number]))
            start = own.stop
            used, rejected = [], dict[int, Reason]()
            for i in np.flatnonzero(usable(flags[own]).any(axis=1)).tolist():
                if late[number]:
                    rejected[i] = Reason.OUT_OF_ORDER
                elif is_duplicate(last, linear[number][i]):
                    rejected[i] = Reason.DUPLICATE
                else:
                    used.append(i)
                    last = linear[number][i]
            yield ScreenedGroup(
                tuple(groups[number]),
                linear[number],
                flags[own],
                reasons[own],
                rejected,
                np.array(used, np.intp),
                grid.projection,
            )


def _with_mean_current(
    innovation: Innovation, linear: LinearMeasurement, projection: Projection
) -> Innovation:
    """Return an innovation with the measured mean along a path and its correction, or with the source that is not the vehicle's own."""
    mean = linear.label.mean
    if mean is None:
        kind = linear.label.kind
        return replace(innovation, mean_kind=kind) if kind else innovation
    if mean.corrected is not None:
        innovation = replace(
            innovation,
            corrected_current=local_mean(mean, projection)[0],
            corrected_std=mean.used_std,
        )
    measured = local_mean(replace(mean, corrected=None), projection)[0]
    return replace(innovation, mean_current=measured, mean_kind=mean.kind, mean_std=mean.error_std)


def local_mean(mean: PathMean, projection: Projection) -> Array:
    """Return a mean along a path, as it is used, along the local axes, shape (1, 2) [m/s], rotated at the end of the path."""
    u, v = rotate_to_local(
        projection, float(mean.longitude[-1]), float(mean.latitude[-1]), *mean.used
    )
    return np.array([[float(u), float(v)]])


def unused_innovation(
    observation: Measurement, flags: NDArray[np.int8], reasons: NDArray[np.int32]
) -> Innovation:
    """Return the innovation of a measurement that has no usable value."""
    depth = observation.linear.value_depth
    blank = np.full((depth.size, 2), np.nan)
    return Innovation(
        time_ns=observation.time_ns,
        depth=depth,
        innovation=blank,
        innovation_std=blank,
        residual=blank,
        prior_innovation=blank,
        nis=np.nan,
        dof=0,
        accepted=False,
        error_inflation=1.0,
        flags=flags,
        reasons=reasons,
        dive=observation.dive,
        source=observation.source,
        decision="unusable",
    )


def is_duplicate(last: LinearMeasurement | None, observation: Measurement) -> bool:
    """Return whether a measurement equals the last one in every number: logged twice, it holds no new information."""
    if last is None or last.time_ns != observation.time_ns:
        return False
    names, linear = ("longitude", "latitude", "depth", "value", "components"), observation.linear
    return all(
        np.array_equal(getattr(last, name), getattr(linear, name), equal_nan=True) for name in names
    )


def _places(measurements: Sequence[LinearMeasurement]) -> tuple[Array, Array]:
    """Return longitude and latitude of measurements, shape (n,) each [degrees]."""
    if all(each.longitude.size == 1 for each in measurements):
        return (
            np.concatenate([each.longitude for each in measurements]),
            np.concatenate([each.latitude for each in measurements]),
        )
    longitude, latitude = np.array([*zip(*(each.middle for each in measurements), strict=True)])
    return longitude, latitude


def local_values(
    measurements: Sequence[LinearMeasurement],
    used: Sequence[NDArray[np.bool_]],
    projection: Projection,
) -> Iterator[tuple[Array, Array]]:
    """Yield the used values of measurements, shape (n, c) [m/s], and the components of the local axes that they measure, shape (c, 2).

    Both components become those of the local axes; directions are those at the last point.
    """
    places = np.array([(each.longitude[-1], each.latitude[-1]) for each in measurements])
    # of true east and true north, shape (2, 2), along the local axes
    axes = rotate_to_local(projection, *places.T[..., None], *np.eye(2))
    for each, own, turn in zip(measurements, used, np.stack(axes, axis=-1), strict=True):
        value, turned = each.value[own], each.components @ turn
        yield (value @ turned, BOTH_COMPONENTS) if len(turned) == 2 else (value, turned)


def relative_velocities(
    profiles: Sequence[LinearMeasurement], used: NDArray[np.bool_], grid: Grid
) -> Array | None:
    """Return the mean velocity of the used bins relative to the platform, shape (n, 2) [m/s], local axes; None where it is not stated."""
    first = profiles[0]
    platform = np.zeros((len(profiles), 2))
    if first.platform_velocity is not None:
        platform = np.array([each.platform_velocity for each in profiles])
    elif first.reference == "absolute" or len(first.components) < 2:
        return None
    velocity = np.where(
        used[..., None], np.array([each.value for each in profiles]) - platform[:, None], 0.0
    )
    mean = velocity.sum(axis=1) / np.maximum(used.sum(axis=1), 1)[:, None]
    return np.column_stack(rotate_to_local(grid.projection, *_places(profiles), *mean.T))
