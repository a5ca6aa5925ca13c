"""What is measured beside the vehicle's own currents: temperature and salinity, and currents at the surface."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.core.observation import Flag, Kind
from replay_kit.measurements.messages.fields import number


@dataclass(frozen=True, slots=True)
class Ctd:
    """A sample of a CTD; NaN where it does not say.

    Attributes:
        depth: [m], positive down.
        temperature: In situ [degrees C].
        salinity: Practical.
        conductivity: [S/m].
        pressure: [dbar].
    """

    depth: float
    temperature: float
    salinity: float
    conductivity: float
    pressure: float


@dataclass(frozen=True, slots=True, eq=False)
class RadarCurrents:
    """What radars measured at one time.

    Attributes:
        longitude: shape (n,) [degrees].
        latitude: shape (n,) [degrees].
        value: shape (n, c) [m/s]: eastward and northward, or along ``direction``.
        error_std: shape (n,) [m/s], of each component.
        direction: shape (n,), of a positive radial, clockwise from true north [degrees]; None for total vectors.
        depth: That the radars see [m].
        averaged: Over which time [s].
        error_length: Over which errors are correlated [m]; 0 where that is not stated.
        suspect: shape (n,), which their quality flags call suspect.
        kind: As in ``Label``.
    """

    longitude: Array
    latitude: Array
    value: Array
    error_std: Array
    direction: Array | None
    depth: float
    averaged: float
    error_length: float
    suspect: NDArray[np.bool_]
    kind: Kind = "radar"

    def part(self, chosen: NDArray[np.bool_]) -> "RadarCurrents":
        """Return some of the vectors."""
        return replace(
            self,
            longitude=self.longitude[chosen],
            latitude=self.latitude[chosen],
            value=self.value[chosen],
            error_std=self.error_std[chosen],
            suspect=self.suspect[chosen],
            direction=None if self.direction is None else self.direction[chosen],
        )

    def within(self, box: tuple[float, float, float, float]) -> "RadarCurrents":
        """Return those in a box of west, south, east, north [degrees]."""
        west, south, east, north = box
        along = (self.longitude - west) % 360.0 <= (east - west) % 360.0
        return self.part(along & (self.latitude >= south) & (self.latitude <= north))


@dataclass(frozen=True, slots=True)
class DrifterFix:
    """Where a drifter was.

    Attributes:
        name: Of the drifter.
        longitude: [degrees].
        latitude: [degrees].
        depth: Of the middle of its drogue [m].
        error: Standard error of each component of its place [m]; NaN where it is not stated.
    """

    name: str
    longitude: float
    latitude: float
    depth: float
    error: float


def drifter_fix(payload: Mapping[str, Any]) -> DrifterFix | str:
    """Return the fix in a ``replay_kit.DrifterFix``, or why there is none."""
    longitude, latitude, depth, error = (
        number(payload.get(name)) for name in ("longitude", "latitude", "depth", "error")
    )
    if payload.get("drogued") is not True:
        return "drifter without its drogue: the wind moves it"
    if not (math.isfinite(longitude) and abs(latitude) <= 90.0 and depth >= 0.0):
        return "drifter: no position, or no depth of its drogue"
    return DrifterFix(str(payload.get("id")), longitude, latitude, depth, error)


def ctd(payload: Mapping[str, Any]) -> Ctd:
    """Return the sample in a ``replay_kit.Ctd``."""
    names = ("depth", "temperature", "salinity", "conductivity", "pressure")
    return Ctd(*(number(payload.get(name)) for name in names))


def radar_currents(payload: Mapping[str, Any]) -> RadarCurrents | str:
    """Return the vectors or radials in a ``replay_kit.RadarCurrents`` that are whole, or why there is none."""
    radials = "speed" in payload
    names = ("speed", "direction") if radials else ("east", "north", "east_error", "north_error")
    columns = [
        np.array(payload[name], np.float64)
        for name in ("longitude", "latitude", *names, *(("error",) if radials else ()))
    ]
    flags = np.array(payload.get("flag", np.ones_like(columns[0])), np.float64)
    if len({each.shape for each in (*columns, flags)}) != 1 or columns[0].ndim != 1:
        return "radar currents: columns of unlike lengths"
    known = np.isfinite(columns).all(axis=0) & (np.abs(columns[1]) <= 90.0)
    known &= (flags != Flag.FAIL) & (flags != Flag.MISSING)
    if not known.any():
        return "radar currents: no vector that is whole"
    longitude, latitude, first, second, *errors = (each[known] for each in columns)
    depth, averaged = number(payload.get("depth")), number(payload.get("averaged"))
    length = number(payload.get("error_length"))
    if not (depth >= 0.0 and averaged > 0.0):
        return "radar currents: depth or time of averaging is not stated"
    value = first[:, None] if radials else np.column_stack([first, second])
    # both components of a vector err alike
    std = errors[0] if radials else np.sqrt(0.5 * (errors[0] ** 2 + errors[1] ** 2))
    return RadarCurrents(
        longitude,
        latitude,
        value,
        std,
        second if radials else None,
        depth,
        averaged,
        length if length > 0.0 else 0.0,
        flags[known] == Flag.SUSPECT,
        kind="sensors" if payload.get("kind") == "sensors" else "radar",
    )
