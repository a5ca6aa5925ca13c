"""Screening: usable bins for an estimator of a region, and innovations of unused measurements; ``assimilate.py`` judges the others."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import groupby, pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array, Indices, replace
from replay_kit.core.geodesy import inside_grid, rotate_to_local, to_local
from replay_kit.core.grid import Grid
from replay_kit.core.observation import (
    BOTH_COMPONENTS,
    Flag,
    Innovation,
    LinearMeasurement,
    Measurement,
    Observation,
    Profiles,
    Reason,
    usable,
)
from replay_kit.core.observation.table import Columns


def screen(
    columns: Columns, grid: Grid, relative: bool = True, places: tuple[Array, Array] | None = None
) -> tuple[NDArray[np.int8], NDArray[np.int32]]:
    """Return flags and reasons of values after the checks of the region, shapes (n, m).

    Args:
        columns: Columns of n measurements of m values each, as in ``Profiles``.
        grid: Grid of the region.
        relative: Whether profiles relative to a platform of unknown velocity are usable.
        places: Longitude and latitude [degrees], shapes (m,), of one measurement with a position per value.
    """
    flags, reasons = columns["flags"].copy(), columns["reasons"].copy()
    depth, value, error_std = columns["depth"], columns["velocity"], columns["error_std"]
    given = (columns["longitude"], columns["latitude"]) if places is None else places
    # shapes (n, 1), or (1, m)
    east, north = (
        each[:, None] if places is None else each[None]
        for each in to_local(grid.projection, *given)
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
    unknown = ~np.isfinite(columns["common_std"])
    alone = unknown & ((np.count_nonzero(usable(flags), axis=1) < 2) | (not relative))
    reasons[alone] |= np.int32(Reason.PLATFORM_REFERENCE)
    flags[alone[:, None] & usable(flags)] = Flag.FAIL
    return flags, reasons


def _is_wet(grid: Grid, depth: Array, east: Array, north: Array) -> NDArray[np.bool_]:
    """Return whether values, shape (n, m), lie in the forecast's water: wet at the nearest level and grid point."""
    level = np.argmin(np.abs(depth[..., None] - grid.levels), axis=-1)
    nearest = np.argmin(
        (grid.east.ravel() - east[..., None]) ** 2 + (grid.north.ravel() - north[..., None]) ** 2,
        axis=-1,
    )
    return np.asarray(grid.wet.reshape(grid.levels.size, -1)[level, nearest])


@dataclass(frozen=True, slots=True, eq=False)
class Screened:
    """Group of profiles, or another measurement, after screening: n measurements of m values each.

    Attributes:
        event: Group of profiles, or another measurement.
        columns: Columns of the event, as in ``Profiles``, with depths of values.
        linear: Linear measurement; None for profiles.
        flags: shape (n, m).
        reasons: shape (n, m).
        used: shape (n, m), whether values are used.
        refused: shape (n,), reason why a measurement with usable values is not used.
        turn: shape (n, 2, 2), rotation from true to local axes at the last point of each.
    """

    event: Profiles | LinearMeasurement | Any
    columns: Columns
    linear: LinearMeasurement | None
    flags: NDArray[np.int8]
    reasons: NDArray[np.int32]
    used: NDArray[np.bool_]
    refused: NDArray[np.int32]
    turn: Array

    @property
    def at(self) -> Indices:
        """Indices of measurements with a used value, shape (n',)."""
        return np.flatnonzero(self.used.any(axis=1))

    @property
    def is_used(self) -> bool:
        """Whether any value is used."""
        return bool(self.used.any())

    @property
    def at_one_place(self) -> bool:
        """Whether all points have one longitude and latitude."""
        return self.linear is None or self.linear.at_one_place

    def local(self, at: Indices) -> tuple[Array, Array]:
        """Return values of some measurements, shape (n', m, c) [m/s], and the measured components in local axes, shape (c, 2).

        Two components are rotated to local axes; directions are those at the last point.
        """
        value = self.columns["velocity"][at]
        if self.linear is None:
            return value @ self.turn[at], BOTH_COMPONENTS
        turned = self.linear.components @ self.turn[0]
        return (value @ turned, BOTH_COMPONENTS) if len(turned) == 2 else (value, turned)

    def relative_velocity(self) -> Array | None:
        """Return the mean velocity of used bins relative to the platform, shape (2,) [m/s], local axes; None if not stated."""
        platform, at = self.columns["platform"], self.at
        unknown = np.isnan(platform[:, 0])
        stated = [i for i in at.tolist() if not (unknown[i] and self._is_absolute(i))]
        if not stated:
            return None
        value, axes = self.columns["velocity"], np.nan_to_num(platform)
        each = [(value[i, self.used[i]].mean(axis=0) - axes[i]) @ self.turn[i] for i in stated]
        return np.asarray(np.mean(each, axis=0))

    def _is_absolute(self, i: int) -> bool:
        both = self.linear is None or len(self.linear.components) == 2
        return bool(np.isfinite(self.columns["common_std"][i])) or not both

    def unused(self, i: int) -> Innovation:
        """Return the innovation of an unused measurement, with its mean along a path if any."""
        refused = self.refused[i]
        flags, reasons = self.flags[i], self.reasons[i] | refused
        if refused:
            flags = np.where(usable(flags), Flag.FAIL, flags).astype(np.int8)
        depth, event = self.columns["depth"][i], self.event
        blank = np.full((depth.size, 2), np.nan)
        found = Innovation(
            time_ns=int(self.columns["time"][i]),
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
            dive=event.dive,
            source=event.source_of(i) if isinstance(event, Profiles) else event.source,
            decision="rejected" if refused else "unusable",
        )
        if self.linear is None:
            return found
        mean = self.linear.label.mean
        if mean is None:
            return replace(found, mean_kind=self.linear.label.kind)
        if mean.corrected is not None:
            corrected = np.array(mean.corrected) @ self.turn[0]
            found = replace(found, corrected_current=corrected, corrected_std=mean.used_std)
        measured = np.array(mean.velocity) @ self.turn[0]
        return replace(found, mean_current=measured, mean_kind=mean.kind, mean_std=mean.error_std)


#: What is remembered of the last measurement used: when, where and what it was; an equal one that follows is a duplicate.
Last = tuple[int, tuple[Any, ...]]


def screened(
    events: Iterable[Measurement],
    grid: Grid,
    last: Last | None = None,
    earliest: float = -np.inf,
    relative: bool = True,
) -> tuple[list[Screened], Last | None]:
    """Return measurements after screening, and the last used one; profiles of equal length are screened together.

    Args:
        events: Measurements in order.
        grid: Grid of the region.
        last: Last used measurement before them.
        earliest: Time before which measurements are too old [ns, UTC].
        relative: See ``screen``.
    """
    found = list[Screened]()
    given = [Profiles.of([one]) if isinstance(one, Observation) else one for one in events]
    for _, alike in groupby(enumerate(given), _shape):
        some = [event for _, event in alike]
        columns, linear = _columns(some)
        places, ends = None, (columns["longitude"], columns["latitude"])
        if linear is not None:
            places = None if linear.at_one_place else linear.value_places
            ends = linear.longitude[-1:], linear.latitude[-1:]
        flags, reasons = screen(columns, grid, relative, places)
        axes = rotate_to_local(grid.projection, *(each[:, None] for each in ends), *np.eye(2))
        turn, used, refused = np.stack(axes, -1), usable(flags), np.zeros(len(flags), np.int32)
        bounds = np.cumsum([0, *(len(one) if isinstance(one, Profiles) else 1 for one in some)])
        parts = [slice(*each) for each in pairwise(bounds.tolist())]
        for part in parts:
            if columns["time"][part].min() < earliest:
                refused[part] = Reason.OUT_OF_ORDER
        last = _refuse_duplicates(columns, used, refused, last)
        refused[~used.any(axis=1)] = Reason.NONE
        used &= refused[:, None] == Reason.NONE
        for event, part in zip(some, parts, strict=True):
            rows = columns if len(some) == 1 else {k: v[part] for k, v in columns.items()}
            each: list[Any] = [one[part] for one in (flags, reasons, used, refused, turn)]
            found.append(Screened(event, rows, linear, *each))
    return found, last


def _shape(numbered: tuple[int, Measurement]) -> tuple[int, int]:
    """Return the key of events that are screened together: the number of bins of profiles."""
    number, event = numbered
    return (event["depth"].shape[1], -1) if isinstance(event, Profiles) else (0, number)


def _columns(events: Sequence[Any]) -> tuple[Columns, LinearMeasurement | None]:
    """Return the columns of events that are screened together, and the linear form of one that is no profile."""
    if not isinstance(events[0], Profiles):
        return columns_of(events[0]), events[0].linear
    if len(events) == 1:
        return events[0].columns, None
    names = events[0].columns.keys()
    return {name: np.concatenate([one[name] for one in events]) for name in names}, None


def columns_of(event: Measurement) -> Columns:
    """Return an event as columns of ``Profiles``: one row, with depths of values."""
    if isinstance(event, Profiles):
        return event.columns
    linear = event.linear
    longitude, latitude = linear.middle
    return {
        "time": np.array([linear.time_ns]),
        "longitude": np.array([longitude]),
        "latitude": np.array([latitude]),
        "depth": linear.value_depth[None],
        "velocity": linear.value[None],
        "error_std": linear.error_std[None],
        "flags": linear.flags[None],
        "reasons": linear.reasons[None],
        "common_std": np.array([linear.common_std]),
        "correlation_depth": np.array([linear.correlation_depth]),
        "platform": np.array([linear.platform_velocity or (np.nan, np.nan)]),
    }


def _refuse_duplicates(
    columns: Columns, used: NDArray[np.bool_], refused: NDArray[np.int32], last: Last | None
) -> Last | None:
    """Mark measurements that repeat the last used one, also from a log of fewer digits, and add nothing; return the last used."""
    times = columns["time"].tolist()
    for i in np.flatnonzero(used.any(axis=1) & (refused == Reason.NONE)).tolist():
        found = times[i], tuple(columns[name][i] for name in _NUMBERS)
        if last is not None and found[0] == last[0] and all(map(_alike, found[1], last[1])):
            refused[i] = Reason.DUPLICATE
        else:
            last = found
    return last


def _alike(one: Array, other: Array) -> bool:
    """Return whether values differ by rounding to 32 bits at most."""
    same = np.shape(one) == np.shape(other)
    return same and np.allclose(one, other, rtol=_ROUNDING, atol=_ROUNDING, equal_nan=True)


_NUMBERS = ("longitude", "latitude", "depth", "velocity")
# Of float32, and of degrees stored as integers: 1e-7.
_ROUNDING = 1e-6
