"""The quality tests of one ping: its fields and the limits of the configuration, put to the functions in ``quality``.

A test whose input the ping does not have is not evaluated, and says why.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.arrays import Array
from replay_kit.core.observation import Flag, Reason
from replay_kit.measurements.ping.payload import ORIENTATIONS, Profile, known_word, number
from replay_kit.measurements.quality import tests as quality
from replay_kit.measurements.quality.tests import Flags, Limits

_OFF = "switched off"
_MADE_OF_MANY = "made of many pings"


@dataclass(frozen=True, slots=True, eq=False)
class Check:
    """What one test said of a ping.

    Attributes:
        test: Its name, as in the configuration.
        reason: What a bin is marked with that it finds suspect or fails.
        flags: shape (n,), QARTOD flags.
        why_not: Why it could not be made; empty when it was.
    """

    test: str
    reason: Reason
    flags: Flags
    why_not: str = ""


@lru_cache(maxsize=64)
def _not_evaluated(n: int) -> Flags:
    return np.full(n, Flag.NOT_EVALUATED, np.int8)


@dataclass(frozen=True, slots=True, eq=False)
class _Asked:
    """A ping with what its tests are made of."""

    payload: Mapping[str, Any]
    profile: Profile
    vehicle_depth: float
    dive: int
    config: MeasurementConfig

    @property
    def n(self) -> int:
        return int(self.profile.depth.size)

    @property
    def derived(self) -> bool:
        return self.payload.get("derived") is True

    def graded(self, test: str, reason: Reason, values: Array | str, limits: Limits, least: bool) -> Check:
        """Return a test of one number a bin, or why there are none."""
        if limits == (None, None):
            return self.without(test, reason, _OFF)
        if isinstance(values, str):
            return self.without(test, reason, values)
        return Check(test, reason, quality.graded(values, limits, least))

    def without(self, test: str, reason: Reason, why: str) -> Check:
        return Check(test, reason, _not_evaluated(self.n), why)

    def cells(self, name: str) -> Array | str:
        """Return a field with one or more numbers a cell, shape (n, k), or why there is none; protobuf carries them flat."""
        raw = self.payload.get(name)
        if not isinstance(raw, list | tuple) or not raw:
            return f"the ping has no {name}"
        values = _rows(raw, self.n)
        if values is None:
            return f"{name} is not as long as the velocity"
        return values if np.isfinite(values).any() else f"the ping has no {name}"


@np.errstate(all="ignore")
def checks(payload: Mapping[str, Any], profile: Profile, vehicle_depth: float, dive: int, config: MeasurementConfig) -> tuple[Check, ...]:
    """Return what each test says of a ping's bins.

    Args:
        payload: Fields of the ping, as ``earth_referenced`` gave it.
        profile: Its bins.
        vehicle_depth: Of the vehicle when the ping came [m]; NaN when unknown.
        dive: The dive the ping belongs to; 0 before the first and for a vehicle that does not dive.
        config: The limits.
    """
    asked = _Asked(payload, profile, vehicle_depth, dive, config)
    limits = config.quality.limits
    correlation = "nortek_correlation" if payload.get("attitude_convention") == "nortek" else "correlation"
    found = [
        asked.graded("above_surface", Reason.ABOVE_SURFACE, profile.depth, (None, 0.0), least=True),
        asked.graded("max_speed", Reason.GROSS_RANGE, np.abs(profile.velocity).max(axis=1), (None, config.max_speed), least=False),
        _bottom(asked),
        asked.graded(correlation, Reason.LOW_CORRELATION, _needed(asked.cells("correlation")), limits(correlation), least=True),
        asked.graded("amplitude", Reason.LOW_AMPLITUDE, _needed(asked.cells("amplitude")), limits("amplitude"), least=True),
        asked.graded("snr", Reason.LOW_SNR, _needed(_snr(asked)), limits("snr"), least=True),
        asked.graded("percent_good", Reason.LOW_PERCENT_GOOD, _percent_good(asked), limits("percent_good"), least=True),
        asked.graded("error_velocity", Reason.ERROR_VELOCITY, _error_velocity(asked), limits("error_velocity"), least=False),
        asked.graded("speed", Reason.HIGH_SPEED, _speed(profile), limits("speed"), least=False),
        asked.graded("tilt", Reason.TILT, _tilt(asked), limits("tilt"), least=False),
        _surface(asked),
        _at_surface(asked),
    ]
    return (*found, _outlier(asked, found))


def flags_of(profile: Profile, found: tuple[Check, ...], use_suspect: bool) -> tuple[Flags, NDArray[np.int32]]:
    """Return the flags and reasons of a profile's bins after all tests; a bin without a number is missing."""
    missing = np.zeros(profile.depth.size, np.int32)
    missing[~np.isfinite(profile.depth)] |= Reason.MALFORMED
    missing[~np.isfinite(profile.velocity).all(axis=1)] |= Reason.MISSING
    return quality.rolled_up([(check.reason, check.flags) for check in found], missing, use_suspect)


def _rows(raw: Sequence[Any], n: int) -> Array | None:
    """Return the numbers of n cells, shape (n, k), NaN for what is none; None when they are not n cells."""
    try:
        values = np.array(raw, np.float64)
    except (TypeError, ValueError, OverflowError):
        # cells of different lengths, or something among them that is no number
        rows = [[number(value) for value in (cell if isinstance(cell, list | tuple) else [cell])] for cell in raw]
        width = max(map(len, rows))
        values = np.array([row + [np.nan] * (width - len(row)) for row in rows])
    if values.ndim > 2 or values.size == 0 or values.size % n or (values.ndim == 2 and len(values) != n):
        return None
    return np.where(np.isfinite(values), values, np.nan).reshape(n, -1)


def _needed(cells: Array | str) -> Array | str:
    return cells if isinstance(cells, str) else quality.worst_needed(cells)


def _snr(asked: _Asked) -> Array | str:
    """Return the stated ratio of signal to noise, else the echo over the noise's [dB]."""
    stated = asked.cells("snr")
    if not isinstance(stated, str):
        return stated
    floor, echo = asked.payload.get("noise_floor"), asked.cells("amplitude")
    floors = np.array([number(value) for value in (floor if isinstance(floor, list | tuple) and floor else [floor])])
    if isinstance(echo, str) or not np.isfinite(floors).any():
        return "the ping has neither snr nor noise_floor with amplitude"
    if floors.size not in (1, echo.shape[1]):
        return "noise_floor is neither one number nor one a beam"
    return np.asarray(echo - floors)


def _percent_good(asked: _Asked) -> Array | str:
    values = asked.cells("percent_good")
    if isinstance(values, str):
        return values
    beams = asked.payload.get("turned_from", asked.payload.get("coordinate_system")) in ("beam", 0)
    # of the makers whose instruments turn velocities only Teledyne writes four numbers
    return quality.percent_good(values, not beams and asked.payload.get("attitude_convention") != "nortek")


def _error_velocity(asked: _Asked) -> Array | str:
    """Return the size of the error velocity [m/s]: stated, or the fourth component of the velocity."""
    stated = asked.cells("error_velocity")
    if not isinstance(stated, str):
        return np.abs(stated[:, 0])
    velocity = asked.cells("velocity")
    if isinstance(velocity, str) or velocity.shape[1] < 4:
        return "the ping has no error velocity"
    return np.abs(velocity[:, 3])


def _speed(profile: Profile) -> Array | str:
    if profile.reference == "platform":
        return "velocity is relative to the platform"
    return np.asarray(np.hypot(profile.velocity[:, 0], profile.velocity[:, 1]))


def _tilt(asked: _Asked) -> Array | str:
    angle = quality.tilt(number(asked.payload.get("pitch")), number(asked.payload.get("roll")))
    if not np.isfinite(angle):
        return "the ping has no pitch and roll"
    # how an instrument is mounted in a glider, level in the glide or not, no ping says
    return "a vehicle that dives leans to glide" if asked.dive > 0 else np.full(asked.n, angle)


def _cosine(asked: _Asked) -> float:
    """Return the cosine of the widest beam's angle; of the configured angle where the ping does not say."""
    vectors = asked.payload.get("beam_unit_vectors")
    try:
        heights = np.abs(np.array(vectors, np.float64).reshape(-1, 3)[:, 2])
    except (TypeError, ValueError, OverflowError):
        heights = np.array([np.nan])
    known = heights.size > 0 and np.isfinite(heights).all() and 0.0 < heights.min() <= 1.0
    return float(heights.min() if known else np.cos(np.deg2rad(asked.config.quality.beam_angle)))


def _sidelobe(asked: _Asked, test: str, reason: Reason, boundary: float, why_not: str) -> Check:
    if why_not:
        return asked.without(test, reason, why_not)
    distance, size = asked.profile.distance, number(asked.payload.get("cell_size"))
    steps = np.abs(np.diff(distance))
    if not np.isfinite(size) and np.isfinite(steps).any():
        size = float(np.nanmedian(steps))
    return Check(test, reason, quality.sidelobe(distance, size, boundary, _cosine(asked)))


def _bottom(asked: _Asked) -> Check:
    """Return the test against the bottom, nearest of the distances that the beams' bottom tracks give."""
    track = asked.payload.get("bottom_track")
    listed = track.get("distance") if isinstance(track, Mapping) else None
    distances = np.array([number(value) for value in listed] if isinstance(listed, list | tuple) else [])
    nearest = float(np.nanmin(distances)) if np.isfinite(distances).any() else np.nan
    return _sidelobe(asked, "bottom", Reason.BELOW_BOTTOM, nearest, "" if np.isfinite(nearest) else "no bottom track")


def _surface(asked: _Asked) -> Check:
    """Return the test of an instrument that looks up against the surface."""
    why_not = "" if asked.config.quality.sidelobe else _OFF
    if known_word(asked.payload, "orientation", ORIENTATIONS) == "down":
        why_not = why_not or "the instrument looks down"
    return _sidelobe(asked, "sidelobe", Reason.SIDELOBE, asked.profile.transducer_depth, why_not)


def _at_surface(asked: _Asked) -> Check:
    """Return the test of a vehicle that dives for being at the surface, where it rolls in the waves with its bubbles."""
    test, reason, word = "at_surface", Reason.AT_SURFACE, asked.config.quality.at_surface
    if word == "off" or asked.dive == 0 or asked.derived:
        return asked.without(test, reason, _OFF if word == "off" else _MADE_OF_MANY if asked.derived else "no dive yet")
    # the depth of the vehicle may be an older one than the ping's own
    depth = np.fmax(asked.vehicle_depth, asked.profile.transducer_depth)
    bad = Flag.SUSPECT if word == "suspect" else Flag.FAIL
    return Check(test, reason, np.full(asked.n, bad if depth < asked.config.surface_depth else Flag.GOOD, np.int8))


def _outlier(asked: _Asked, found: list[Check]) -> Check:
    """Return the test of each bin against those around it that no other test failed."""
    limits, settings, profile = asked.config.quality.limits("outlier"), asked.config.quality, asked.profile
    failed = (np.array([check.flags for check in found]) == Flag.FAIL).any(axis=0) | ~np.isfinite(profile.depth)
    velocity = np.where(failed[:, None], np.nan, profile.velocity)
    floor = np.maximum(profile.error_std, settings.outlier_floor)
    ratio = quality.outlyingness(velocity, floor, settings.outlier_window)
    return asked.graded("outlier", Reason.OUTLIER, ratio if np.isfinite(ratio).any() else "too few bins", limits, least=False)
