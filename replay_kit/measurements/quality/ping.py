"""The quality tests of one ping: its fields and the limits of the configuration, put to the functions in ``tests.py``.

A test whose input the ping does not have is not evaluated, and says why.
"""

import math

import numpy as np
from numpy.typing import NDArray

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.arrays import Array
from replay_kit.core.observation import Flag, Reason
from replay_kit.measurements.ping.adcp_ping import AdcpPing
from replay_kit.measurements.ping.profile import Profile
from replay_kit.measurements.quality import tests as quality
from replay_kit.measurements.quality.tests import Check, Flags, Limits

_FAIL, _MALFORMED, _MISSING = np.int8(Flag.FAIL), np.int32(Reason.MALFORMED), np.int32(Reason.MISSING)


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
    limits, fields, n = config.quality.limits, ping.quality, profile.depth.size
    nortek = "nortek_" if ping.attitude.convention == "nortek" else ""
    # name, reason, a number a bin or a beam, limits, whether these are the least that is good
    rows: tuple[tuple[str, Reason, Array | str, Limits, bool], ...] = (
        ("above_surface", Reason.ABOVE_SURFACE, profile.depth, (None, 0.0), True),
        ("max_speed", Reason.GROSS_RANGE, np.abs(profile.velocity).max(axis=1), (None, config.max_speed), False),
        ("bottom", Reason.BELOW_BOTTOM, *_bottom(ping, profile, config), False),
        (f"{nortek}correlation", Reason.LOW_CORRELATION, fields.correlation, limits(f"{nortek}correlation"), True),
        ("amplitude", Reason.LOW_AMPLITUDE, fields.amplitude, limits("amplitude"), True),
        ("snr", Reason.LOW_SNR, _snr(ping), limits("snr"), True),
        ("percent_good", Reason.LOW_PERCENT_GOOD, _percent_good(ping), limits("percent_good"), True),
        ("error_velocity", Reason.ERROR_VELOCITY, _error_velocity(ping), limits("error_velocity"), False),
        ("speed", Reason.HIGH_SPEED, _speed(profile), limits("speed"), False),
        ("tilt", Reason.TILT, _tilt(ping, n, dive), limits("tilt"), False),
        ("sidelobe", Reason.SIDELOBE, *_surface(ping, profile, config), False),
        ("at_surface", Reason.AT_SURFACE, *_at_surface(ping, profile, vehicle_depth, dive, config), True),
    )
    found = [quality.check(n, *row) for row in rows]
    # each bin against those around it that no other test failed
    failed = (np.array([check.flags for check in found]) == _FAIL).any(axis=0) | ~np.isfinite(profile.depth)
    velocity = np.where(failed[:, None], np.nan, profile.velocity)
    floor = np.maximum(profile.error_std, config.quality.outlier_floor)
    ratio = quality.outlyingness(velocity, floor, config.quality.outlier_window)
    outlier = ratio if np.isfinite(ratio).any() else "too few bins"
    return (*found, quality.check(n, "outlier", Reason.OUTLIER, outlier, limits("outlier"), False))


def flags_of(profile: Profile, found: tuple[Check, ...], use_suspect: bool) -> tuple[Flags, NDArray[np.int32]]:
    """Return the flags and reasons of a profile's bins after all tests; a bin without a number is missing."""
    missing = np.zeros(profile.depth.size, np.int32)
    missing[~np.isfinite(profile.depth)] |= _MALFORMED
    missing[~np.isfinite(profile.velocity).all(axis=1)] |= _MISSING
    return quality.rolled_up(found, missing, use_suspect)


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
    """Return the percentage of solutions in each cell: one number a cell, one a beam, or the sum of Teledyne's first and last.

    Teledyne's four, of velocities that the instrument turned, are three-beam solutions, rejected ones, cells with too few beams,
    four-beam solutions.
    """
    values = ping.quality.percent_good
    # of the makers whose instruments turn velocities only Teledyne writes four numbers
    turned = ping.measured_system != "beam" and ping.attitude.convention != "nortek"
    return np.asarray(values[:, 0] + values[:, 3]) if turned and not isinstance(values, str) and values.shape[1] == 4 else values


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


def tilt(pitch_deg: float, roll_deg: float) -> float:
    """Return the angle between an instrument's axis and the vertical [degrees], whichever way it looks; NaN when not known."""
    if not math.isfinite(pitch_deg + roll_deg):
        return math.nan
    return math.degrees(math.acos(abs(math.cos(math.radians(pitch_deg)) * math.cos(math.radians(roll_deg)))))


def _tilt(ping: AdcpPing, n: int, dive: int) -> Array | str:
    angle = tilt(ping.attitude.pitch, ping.attitude.roll)
    if not np.isfinite(angle):
        return "the ping has no pitch and roll"
    # how an instrument is mounted in a glider, level in the glide or not, no ping says
    return "a vehicle that dives leans to glide" if dive > 0 else np.full(n, angle)


def _cosine(ping: AdcpPing, config: MeasurementConfig) -> float:
    """Return the cosine of the widest beam's angle; of the configured angle where the ping does not say."""
    vectors = ping.beam_vectors
    if vectors is not None and vectors.size and np.isfinite(vectors[:, 2]).all():
        lowest = float(np.abs(vectors[:, 2]).min())
        if 0.0 < lowest <= 1.0:
            return lowest
    return float(np.cos(np.deg2rad(config.quality.beam_angle)))


def sidelobe(distance: Array, cell_size: float, boundary: float, cosine: float) -> tuple[Array, Limits]:
    """Return how far bins reach towards the surface or the bottom, shape (n,) [m], and the limits: those in its side lobe fail.

    A beam's side lobe meets the boundary straight ahead before the beam itself does, so that the last part of the range,
    1 - cos(beam angle) of it, is spoiled.

    Args:
        distance: shape (n,) [m], vertical, from the transducer to the bins' centres.
        cell_size: [m]; a bin of unknown size (NaN) is spoiled when its centre is.
        boundary: [m], vertical, from the transducer to the boundary.
        cosine: Of the angle between a beam and the instrument's axis.
    """
    return distance + (0.5 * cell_size if np.isfinite(cell_size) else 0.0), (None, boundary * cosine)


def _sidelobe(ping: AdcpPing, profile: Profile, boundary: float, config: MeasurementConfig) -> tuple[Array, Limits]:
    size, steps = ping.cell_size, np.abs(np.diff(profile.distance))
    if not np.isfinite(size) and np.isfinite(steps).any():
        size = float(np.nanmedian(steps))
    return sidelobe(profile.distance, size, boundary, _cosine(ping, config))


def _bottom(ping: AdcpPing, profile: Profile, config: MeasurementConfig) -> tuple[Array | str, Limits]:
    """Return the reach and the limits of bins against the bottom, nearest of the distances that the beams' bottom tracks give."""
    distances = np.empty(0) if ping.bottom_track is None else ping.bottom_track.distance
    if not np.isfinite(distances).any():
        return "no bottom track", (None, np.nan)
    return _sidelobe(ping, profile, float(np.nanmin(distances)), config)


def _surface(ping: AdcpPing, profile: Profile, config: MeasurementConfig) -> tuple[Array | str, Limits]:
    """Return the reach and the limits of the bins of an instrument that looks up, against the surface."""
    if not config.quality.sidelobe or ping.orientation == "down":
        return "the instrument looks down" if config.quality.sidelobe else quality.OFF, (None, np.nan)
    return _sidelobe(ping, profile, profile.transducer_depth, config)


def _at_surface(ping: AdcpPing, profile: Profile, vehicle_depth: float, dive: int, config: MeasurementConfig) -> tuple[Array | str, Limits]:
    """Return the depth and the limits of a vehicle that dives: at the surface it rolls in the waves with its bubbles."""
    word = config.quality.at_surface
    limits = (config.surface_depth, None) if word == "suspect" else (None, config.surface_depth)
    if word == "off" or dive == 0 or ping.derived:
        return quality.OFF if word == "off" else "made of many pings" if ping.derived else "no dive yet", limits
    # the depth of the vehicle may be an older one than the ping's own
    return np.full(profile.depth.size, np.fmax(vehicle_depth, profile.transducer_depth)), limits
