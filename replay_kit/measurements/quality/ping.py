"""The quality tests of one ping: its fields and the limits of the configuration, put to the functions in ``tests.py``.

A test whose input the ping does not have is not evaluated, and says why.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.arrays import Array
from replay_kit.core.observation import Flag, Reason
from replay_kit.measurements.ping.adcp_ping import AdcpPing
from replay_kit.measurements.ping.profile import Profile
from replay_kit.measurements.quality import tests as quality
from replay_kit.measurements.quality.tests import Flags, Limits

_OFF = "switched off"
_MADE_OF_MANY = "made of many pings"


@dataclass(frozen=True, slots=True, eq=False)
class Check:
    """The result of one test of a ping.

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
class _Subject:
    """A ping with what its tests are made of."""

    ping: AdcpPing
    profile: Profile
    vehicle_depth: float
    dive: int
    config: MeasurementConfig

    @property
    def n(self) -> int:
        return int(self.profile.depth.size)

    def graded(self, test: str, reason: Reason, values: Array | str, limits: Limits, least: bool) -> Check:
        """Return a test of one number a bin, or why there are none."""
        if limits == (None, None):
            return self.without(test, reason, _OFF)
        if isinstance(values, str):
            return self.without(test, reason, values)
        return Check(test, reason, quality.graded(values, limits, least))

    def without(self, test: str, reason: Reason, why: str) -> Check:
        return Check(test, reason, _not_evaluated(self.n), why)


@np.errstate(all="ignore")
def checks(ping: AdcpPing, profile: Profile, vehicle_depth: float, dive: int, config: MeasurementConfig) -> tuple[Check, ...]:
    """Return what each test says of a ping's bins.

    Args:
        ping: The ping, as ``earth_referenced`` gave it.
        profile: Its bins.
        vehicle_depth: Of the vehicle when the ping came [m]; NaN when unknown.
        dive: The dive the ping belongs to; 0 before the first and for a vehicle that does not dive.
        config: The limits.
    """
    subject = _Subject(ping, profile, vehicle_depth, dive, config)
    limits = config.quality.limits
    correlation = "nortek_correlation" if ping.attitude.convention == "nortek" else "correlation"
    found = [
        subject.graded("above_surface", Reason.ABOVE_SURFACE, profile.depth, (None, 0.0), least=True),
        subject.graded("max_speed", Reason.GROSS_RANGE, np.abs(profile.velocity).max(axis=1), (None, config.max_speed), least=False),
        _bottom(subject),
        subject.graded(correlation, Reason.LOW_CORRELATION, _needed(ping.quality.correlation), limits(correlation), least=True),
        subject.graded("amplitude", Reason.LOW_AMPLITUDE, _needed(ping.quality.amplitude), limits("amplitude"), least=True),
        subject.graded("snr", Reason.LOW_SNR, _needed(_snr(ping)), limits("snr"), least=True),
        subject.graded("percent_good", Reason.LOW_PERCENT_GOOD, _percent_good(ping), limits("percent_good"), least=True),
        subject.graded("error_velocity", Reason.ERROR_VELOCITY, _error_velocity(ping), limits("error_velocity"), least=False),
        subject.graded("speed", Reason.HIGH_SPEED, _speed(profile), limits("speed"), least=False),
        subject.graded("tilt", Reason.TILT, _tilt(subject), limits("tilt"), least=False),
        _surface(subject),
        _at_surface(subject),
    ]
    return (*found, _outlier(subject, found))


def flags_of(profile: Profile, found: tuple[Check, ...], use_suspect: bool) -> tuple[Flags, NDArray[np.int32]]:
    """Return the flags and reasons of a profile's bins after all tests; a bin without a number is missing."""
    missing = np.zeros(profile.depth.size, np.int32)
    missing[~np.isfinite(profile.depth)] |= Reason.MALFORMED
    missing[~np.isfinite(profile.velocity).all(axis=1)] |= Reason.MISSING
    return quality.rolled_up([(check.reason, check.flags) for check in found], missing, use_suspect)


def _needed(cells: Array | str) -> Array | str:
    return cells if isinstance(cells, str) else quality.worst_needed(cells)


def _snr(ping: AdcpPing) -> Array | str:
    """Return the stated ratio of signal to noise, else the echo over the noise's [dB]."""
    fields = ping.quality
    if not isinstance(fields.snr, str):
        return fields.snr
    if isinstance(fields.amplitude, str) or not np.isfinite(fields.noise_floor).any():
        return "the ping has neither snr nor noise_floor with amplitude"
    if fields.noise_floor.size not in (1, fields.amplitude.shape[1]):
        return "noise_floor is neither one number nor one a beam"
    return np.asarray(fields.amplitude - fields.noise_floor)


def _percent_good(ping: AdcpPing) -> Array | str:
    values = ping.quality.percent_good
    if isinstance(values, str):
        return values
    # of the makers whose instruments turn velocities only Teledyne writes four numbers
    return quality.percent_good(values, ping.measured_system != "beam" and ping.attitude.convention != "nortek")


def _error_velocity(ping: AdcpPing) -> Array | str:
    """Return the size of the error velocity [m/s]: stated, or the fourth component of the velocity."""
    stated, velocity = ping.quality.error_velocity, ping.velocity
    if not isinstance(stated, str) and np.isfinite(stated).any():
        return np.abs(stated[:, 0])
    if velocity.shape[1] < 4 or not np.isfinite(velocity).any():
        return "the ping has no error velocity"
    return np.abs(velocity[:, 3])


def _speed(profile: Profile) -> Array | str:
    if profile.reference == "platform":
        return "velocity is relative to the platform"
    return np.asarray(np.hypot(profile.velocity[:, 0], profile.velocity[:, 1]))


def _tilt(subject: _Subject) -> Array | str:
    angle = quality.tilt(subject.ping.attitude.pitch, subject.ping.attitude.roll)
    if not np.isfinite(angle):
        return "the ping has no pitch and roll"
    # how an instrument is mounted in a glider, level in the glide or not, no ping says
    return "a vehicle that dives leans to glide" if subject.dive > 0 else np.full(subject.n, angle)


def _cosine(subject: _Subject) -> float:
    """Return the cosine of the widest beam's angle; of the configured angle where the ping does not say."""
    vectors = subject.ping.beam_vectors
    if vectors is not None and vectors.size and np.isfinite(vectors[:, 2]).all():
        lowest = float(np.abs(vectors[:, 2]).min())
        if 0.0 < lowest <= 1.0:
            return lowest
    return float(np.cos(np.deg2rad(subject.config.quality.beam_angle)))


def _sidelobe(subject: _Subject, test: str, reason: Reason, boundary: float, why_not: str) -> Check:
    if why_not:
        return subject.without(test, reason, why_not)
    distance, size = subject.profile.distance, subject.ping.cell_size
    steps = np.abs(np.diff(distance))
    if not np.isfinite(size) and np.isfinite(steps).any():
        size = float(np.nanmedian(steps))
    return Check(test, reason, quality.sidelobe(distance, size, boundary, _cosine(subject)))


def _bottom(subject: _Subject) -> Check:
    """Return the test against the bottom, nearest of the distances that the beams' bottom tracks give."""
    track = subject.ping.bottom_track
    distances = np.empty(0) if track is None else track.distance
    nearest = float(np.nanmin(distances)) if np.isfinite(distances).any() else np.nan
    return _sidelobe(subject, "bottom", Reason.BELOW_BOTTOM, nearest, "" if np.isfinite(nearest) else "no bottom track")


def _surface(subject: _Subject) -> Check:
    """Return the test of an instrument that looks up against the surface."""
    why_not = "" if subject.config.quality.sidelobe else _OFF
    if subject.ping.orientation == "down":
        why_not = why_not or "the instrument looks down"
    return _sidelobe(subject, "sidelobe", Reason.SIDELOBE, subject.profile.transducer_depth, why_not)


def _at_surface(subject: _Subject) -> Check:
    """Return the test of a vehicle that dives for being at the surface, where it rolls in the waves with its bubbles."""
    test, reason, word = "at_surface", Reason.AT_SURFACE, subject.config.quality.at_surface
    if word == "off" or subject.dive == 0 or subject.ping.derived:
        return subject.without(test, reason, _OFF if word == "off" else _MADE_OF_MANY if subject.ping.derived else "no dive yet")
    # the depth of the vehicle may be an older one than the ping's own
    depth = np.fmax(subject.vehicle_depth, subject.profile.transducer_depth)
    bad = Flag.SUSPECT if word == "suspect" else Flag.FAIL
    return Check(test, reason, np.full(subject.n, bad if depth < subject.config.surface_depth else Flag.GOOD, np.int8))


def _outlier(subject: _Subject, found: list[Check]) -> Check:
    """Return the test of each bin against those around it that no other test failed."""
    limits, settings, profile = subject.config.quality.limits("outlier"), subject.config.quality, subject.profile
    failed = (np.array([check.flags for check in found]) == Flag.FAIL).any(axis=0) | ~np.isfinite(profile.depth)
    velocity = np.where(failed[:, None], np.nan, profile.velocity)
    floor = np.maximum(profile.error_std, settings.outlier_floor)
    ratio = quality.outlyingness(velocity, floor, settings.outlier_window)
    return subject.graded("outlier", Reason.OUTLIER, ratio if np.isfinite(ratio).any() else "too few bins", limits, least=False)
