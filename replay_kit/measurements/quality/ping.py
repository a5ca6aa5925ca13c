"""The quality tests of pings: their fields and the limits of the configuration, put to the functions in ``qartod.py``.

A test whose input the ping does not have is not evaluated, and says why.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.arrays import Array
from replay_kit.core.observation import Flag, Reason
from replay_kit.measurements.ping.adcp_ping import AdcpPing
from replay_kit.measurements.ping.profile import Profiles
from replay_kit.measurements.quality import qartod as quality
from replay_kit.measurements.quality.qartod import Checks, Flags, Limits, Values

_FAIL, _MALFORMED, _MISSING = (
    np.int8(Flag.FAIL),
    np.int32(Reason.MALFORMED),
    np.int32(Reason.MISSING),
)


@dataclass(frozen=True, slots=True, eq=False)
class PingBlock:
    """Pings that are tested together.

    Attributes:
        pings: As ``earth_referenced`` gave them, all of as many cells.
        profiles: Their bins.
        vehicle_depth: Of the vehicle when each came [m]; NaN when unknown.
        dive: The dive each belongs to; 0 before the first and for a vehicle that does not dive.
    """

    pings: Sequence[AdcpPing]
    profiles: Profiles
    vehicle_depth: Sequence[float]
    dive: Sequence[int]

    @property
    def shape(self) -> tuple[int, int]:
        """Number of pings, and of their cells."""
        n, cells = self.profiles.depth.shape
        return n, cells


@np.errstate(all="ignore")
def checks(tested: PingBlock, config: MeasurementConfig) -> tuple[Checks, ...]:
    """Return what each test says of the bins of some pings, all of them with beams of one maker's convention or none.

    Args:
        tested: The pings.
        config: The limits.
    """
    limits, pings, profiles, shape = (
        config.quality.limits,
        tested.pings,
        tested.profiles,
        tested.shape,
    )
    nortek = "nortek_" if is_nortek(pings[0]) else ""
    # name, reason, numbers a bin or a beam, limits, whether these are the least that is good
    rows: tuple[tuple[str, Reason, Values, Limits | Sequence[Limits], bool], ...] = (
        ("above_surface", Reason.ABOVE_SURFACE, profiles.depth, (None, 0.0), True),
        (
            "max_speed",
            Reason.GROSS_RANGE,
            np.abs(profiles.velocity).max(axis=2),
            (None, config.max_speed),
            False,
        ),
        (
            "bottom",
            Reason.BELOW_BOTTOM,
            *_of_each([_bottom(ping, config) for ping in pings]),
            False,
        ),
        (
            f"{nortek}correlation",
            Reason.LOW_CORRELATION,
            [ping.quality.correlation for ping in pings],
            limits(f"{nortek}correlation"),
            True,
        ),
        (
            "amplitude",
            Reason.LOW_AMPLITUDE,
            [ping.quality.amplitude for ping in pings],
            limits("amplitude"),
            True,
        ),
        ("snr", Reason.LOW_SNR, [_snr(ping) for ping in pings], limits("snr"), True),
        (
            "percent_good",
            Reason.LOW_PERCENT_GOOD,
            [_percent_good(ping) for ping in pings],
            limits("percent_good"),
            True,
        ),
        (
            "error_velocity",
            Reason.ERROR_VELOCITY,
            [_error_velocity(ping) for ping in pings],
            limits("error_velocity"),
            False,
        ),
        ("speed", Reason.HIGH_SPEED, _speed(tested), limits("speed"), False),
        ("tilt", Reason.TILT, _tilt(tested), limits("tilt"), False),
        ("sidelobe", Reason.SIDELOBE, *_of_each(_surface(tested, config)), False),
        ("at_surface", Reason.AT_SURFACE, *_at_surface(tested, config), True),
    )
    found = [quality.check(shape, *row) for row in rows]
    # each bin against those around it that no other test failed
    failed = np.any(
        [check.flags == _FAIL for check in found if check.flags is not None], axis=0
    ) | ~np.isfinite(profiles.depth)
    velocity = np.where(failed[..., None], np.nan, profiles.velocity)
    floor = np.maximum(profiles.error_std, config.quality.outlier_floor)
    ratio = quality.outlyingness(velocity, floor, config.quality.outlier_window)
    known: list[bool] = np.asarray(np.isfinite(ratio).any(axis=1)).tolist()
    outlier: Values = (
        ratio
        if all(known)
        else [
            row if is_known else "too few bins" for row, is_known in zip(ratio, known, strict=True)
        ]
    )
    return (
        *found,
        quality.check(shape, "outlier", Reason.OUTLIER, outlier, limits("outlier"), False),
    )


def is_nortek(ping: AdcpPing) -> bool:
    """Return whether a ping's correlations are on Nortek's scale."""
    return ping.attitude.convention == "nortek"


def flags_of(
    profiles: Profiles, found: Sequence[Checks], use_suspect: bool
) -> tuple[Flags, NDArray[np.int32]]:
    """Return the flags and reasons of profiles' bins after all tests, shapes (s, n); a bin without a number is missing."""
    missing = np.where(np.isfinite(profiles.depth), np.int32(0), _MALFORMED)
    missing |= np.where(np.isfinite(profiles.velocity).all(axis=2), np.int32(0), _MISSING)
    return quality.rolled_up(found, missing, use_suspect)


def _of_each(found: Sequence[tuple[Array | str, Limits]]) -> tuple[list[Array | str], list[Limits]]:
    """Return what is tested of each ping, and the limits."""
    return [values for values, _ in found], [limits for _, limits in found]


def _over_bins(values: Sequence[float | str], n: int) -> Values:
    """Return numbers that all n bins of a ping share, or why there are none."""
    if any(isinstance(value, str) for value in values):
        return [value if isinstance(value, str) else np.full(n, value) for value in values]
    return np.broadcast_to(np.array(values, np.float64)[:, None], (len(values), n))


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
    return (
        np.asarray(values[:, 0] + values[:, 3])
        if turned and not isinstance(values, str) and values.shape[1] == 4
        else values
    )


def _error_velocity(ping: AdcpPing) -> Array | str:
    """Return the size of the error velocity [m/s]: stated, or the fourth component of the velocity."""
    stated, velocity = ping.quality.error_velocity, ping.velocity
    if not isinstance(stated, str) and np.isfinite(stated).any():
        return np.abs(stated[:, 0])
    if velocity.shape[1] < 4 or not np.isfinite(velocity).any():
        return "the ping has no error velocity"
    return np.abs(velocity[:, 3])


def _speed(tested: PingBlock) -> Values:
    speed = np.hypot(tested.profiles.velocity[..., 0], tested.profiles.velocity[..., 1])
    relative = [ping.reference == "platform" for ping in tested.pings]
    if not any(relative):
        return np.asarray(speed)
    return [
        "velocity is relative to the platform" if is_relative else row
        for row, is_relative in zip(speed, relative, strict=True)
    ]


def tilt(pitch_deg: float, roll_deg: float) -> float:
    """Return the angle between an instrument's axis and the vertical [degrees], whichever way it looks; NaN when not known."""
    if not math.isfinite(pitch_deg + roll_deg):
        return math.nan
    return math.degrees(
        math.acos(abs(math.cos(math.radians(pitch_deg)) * math.cos(math.radians(roll_deg))))
    )


def _tilt(tested: PingBlock) -> Values:
    def of(ping: AdcpPing, dive: int) -> float | str:
        angle = tilt(ping.attitude.pitch, ping.attitude.roll)
        if not math.isfinite(angle):
            return "the ping has no pitch and roll"
        # how an instrument is mounted in a glider, level in the glide or not, no ping says
        return "not evaluated for a gliding vehicle" if dive > 0 else angle

    return _over_bins(
        [of(ping, dive) for ping, dive in zip(tested.pings, tested.dive, strict=True)],
        tested.shape[1],
    )


def _cosine(ping: AdcpPing, config: MeasurementConfig) -> float:
    """Return the cosine of the widest beam's angle; of the configured angle where the ping does not say."""
    vectors = ping.beam_vectors
    if vectors is not None and vectors.size and np.isfinite(vectors[:, 2]).all():
        lowest = float(np.abs(vectors[:, 2]).min())
        if 0.0 < lowest <= 1.0:
            return lowest
    return float(np.cos(np.deg2rad(config.quality.beam_angle)))


def sidelobe(
    distance: Array, cell_size: float, boundary: float, cosine: float
) -> tuple[Array, Limits]:
    """Return how far bins reach towards the surface or the bottom, shape (n,) [m], and the limits: those in its side lobe fail.

    A beam's side lobe meets the boundary straight ahead before the beam itself does, so that the last part of the range,
    1 - cos(beam angle) of it, is spoiled.

    Args:
        distance: shape (n,) [m], vertical, from the transducer to the bins' centres.
        cell_size: [m]; a bin of unknown size (NaN) is spoiled when its centre is.
        boundary: [m], vertical, from the transducer to the boundary.
        cosine: Of the angle between a beam and the instrument's axis.
    """
    return distance + (0.5 * cell_size if np.isfinite(cell_size) else 0.0), (
        None,
        boundary * cosine,
    )


def _sidelobe(ping: AdcpPing, boundary: float, config: MeasurementConfig) -> tuple[Array, Limits]:
    size = ping.cell_size
    if not math.isfinite(size) and np.isfinite(steps := np.abs(np.diff(ping.distance))).any():
        size = float(np.nanmedian(steps))
    return sidelobe(ping.distance, size, boundary, _cosine(ping, config))


def _bottom(ping: AdcpPing, config: MeasurementConfig) -> tuple[Array | str, Limits]:
    """Return the reach and the limits of bins against the bottom, nearest of the distances that the beams' bottom tracks give."""
    if ping.bottom_track is None or not np.isfinite(distances := ping.bottom_track.distance).any():
        return "no bottom track", (None, np.nan)
    return _sidelobe(ping, float(np.nanmin(distances)), config)


def _surface(tested: PingBlock, config: MeasurementConfig) -> list[tuple[Array | str, Limits]]:
    """Return the reach and the limits of the bins of instruments that look up, against the surface."""
    if not config.quality.sidelobe:
        return [(quality.OFF, (None, np.nan))] * len(tested.pings)
    return [
        ("the instrument looks down", (None, np.nan))
        if ping.orientation == "down"
        else _sidelobe(ping, top, config)
        for ping, top in zip(tested.pings, tested.profiles.transducer_depth, strict=True)
    ]


def _at_surface(tested: PingBlock, config: MeasurementConfig) -> tuple[Values, Limits]:
    """Return the depth and the limits of a vehicle that dives: at the surface it rolls in the waves with its bubbles."""
    word = config.quality.at_surface
    limits = (config.surface_depth, None) if word == "suspect" else (None, config.surface_depth)

    def of(ping: AdcpPing, top: float, vehicle_depth: float, dive: int) -> float | str:
        if word == "off" or dive == 0 or ping.derived:
            return (
                quality.OFF
                if word == "off"
                else "derived from many pings"
                if ping.derived
                else "no dive yet"
            )
        # the depth of the vehicle may be an older one than the ping's own
        return float(np.fmax(vehicle_depth, top))

    each = zip(
        tested.pings,
        tested.profiles.transducer_depth,
        tested.vehicle_depth,
        tested.dive,
        strict=True,
    )
    return _over_bins([of(*one) for one in each], tested.shape[1]), limits
