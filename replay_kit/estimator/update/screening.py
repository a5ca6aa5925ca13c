"""Screening: which bins of a measurement an estimator of a region can use, and the innovation of a measurement that is not used."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array, replace
from replay_kit.core.geodesy import inside_grid, rotate_to_local, to_local
from replay_kit.core.grid import Grid
from replay_kit.core.observation import (
    BOTH_COMPONENTS,
    Flag,
    Innovation,
    LinearMeasurement,
    Measurement,
    Reason,
    usable,
)


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
    places = first.value_places if spread else np.array([each.middle for each in measurements]).T
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


@dataclass(frozen=True, slots=True, eq=False)
class Screened:
    """A measurement after screening.

    Attributes:
        event: The measurement.
        linear: The same as estimators see it.
        flags: shape (m,).
        reasons: shape (m,).
        used: shape (m,), which values are used.
        refused: Why none is although some are usable.
        turn: shape (2, 2), of true east and true north, along the local axes at its last point.
    """

    event: Measurement
    linear: LinearMeasurement
    flags: NDArray[np.int8]
    reasons: NDArray[np.int32]
    used: NDArray[np.bool_]
    refused: Reason
    turn: Array

    @property
    def is_used(self) -> bool:
        """Whether any is."""
        return bool(self.used.any())

    def local(self) -> tuple[Array, Array]:
        """Return the used values, shape (n, c) [m/s], and the components of the local axes that they measure, shape (c, 2).

        Both components become those of the local axes; directions are those at the last point.
        """
        value, turned = self.linear.value[self.used], self.linear.components @ self.turn
        return (value @ turned, BOTH_COMPONENTS) if len(turned) == 2 else (value, turned)

    def relative_velocity(self) -> Array | None:
        """Return the mean velocity of the used bins relative to the platform, shape (2,) [m/s], local axes; None where it is not stated."""
        linear, platform = self.linear, self.linear.platform_velocity
        if platform is None and (linear.reference == "absolute" or len(linear.components) < 2):
            return None
        return np.asarray((linear.value[self.used].mean(axis=0) - (platform or 0.0)) @ self.turn)

    def among(self, values: Array) -> Array:
        """Return values of the used bins, shape (..., n, 2), among all bins, shape (..., m, 2); NaN for the others."""
        out = np.full((*values.shape[:-2], self.flags.size, 2), np.nan)
        out[..., self.used, :] = values
        return out

    def unused(self) -> Innovation:
        """Return the innovation of a measurement that is not used, with the mean along a path that it states."""
        flags, reasons = self.flags, self.reasons | np.int32(self.refused)
        if self.refused:
            flags = np.where(usable(flags), Flag.FAIL, flags).astype(np.int8)
        blank, mean = unused_innovation(self.event, flags, reasons), self.linear.label.mean
        if self.refused:
            blank = replace(blank, decision="rejected")
        if mean is None:
            return replace(blank, mean_kind=self.linear.label.kind)
        if mean.corrected is not None:
            corrected = np.array(mean.corrected) @ self.turn
            blank = replace(blank, corrected_current=corrected, corrected_std=mean.used_std)
        measured = np.array(mean.velocity) @ self.turn
        return replace(blank, mean_current=measured, mean_kind=mean.kind, mean_std=mean.error_std)


def screened(
    groups: Sequence[Sequence[Measurement]],
    grid: Grid,
    last: LinearMeasurement | None = None,
    earliest: float = -np.inf,
    relative: bool = True,
) -> list[tuple[Screened, ...]]:
    """Return groups of measurements after screening; those of as many values are screened together.

    Args:
        groups: In order; those of a group have as many values each.
        grid: The region.
        last: The last measurement with a usable value before them; an equal one that follows is a duplicate.
        earliest: Time before which they are too old for the estimate [ns, UTC].
        relative: As of ``screen``.
    """
    found = list[tuple[Screened, ...]]()

    def alike(number: int) -> tuple[tuple[int, ...], int]:
        first = groups[number][0].linear
        return first.value.shape, -1 if first.at_one_place else number

    for _, numbers in groupby(range(len(groups)), alike):
        some = [groups[number] for number in numbers]
        events = [event for group in some for event in group]
        linear = [event.linear for event in events]
        ends = np.array([(each.longitude[-1], each.latitude[-1]) for each in linear])
        axes = rotate_to_local(grid.projection, *ends.T[..., None], *np.eye(2))
        each = zip(events, linear, *screen(linear, grid, relative), np.stack(axes, -1), strict=True)
        for group in some:
            old, own = min(event.time_ns for event in group) < earliest, list[Screened]()
            for _ in group:
                event, one, flags, reasons, turn = next(each)
                used, refused = usable(flags), Reason.NONE
                if used.any():
                    if old or is_duplicate(last, one):
                        refused = Reason.OUT_OF_ORDER if old else Reason.DUPLICATE
                        used = np.zeros_like(used)
                    else:
                        last = one
                own.append(Screened(event, one, flags, reasons, used, refused, turn))
            found.append(tuple(own))
    return found


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
