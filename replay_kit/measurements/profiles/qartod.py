"""Quality tests of ADCP bins: functions of arrays, one per test, that return QARTOD flags.

Profiles are tested independently. Flags are good, suspect, fail, or not evaluated without the test's input. Limits are (suspect, fail);
None is no limit. The flag of a bin is the worst of its tests.

Sources: U.S. IOOS, "Manual for Real-Time Quality Control of In-Situ Current Observations" (QARTOD), which names the tests and leaves their
numbers to the operator; Teledyne's commands WC, WE and its percent good; the toolbox of IMOS (side lobe, error velocity, tilt).
"""

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.arrays import Array, Indices, all_along
from replay_kit.core.observation import Flag, Reason
from replay_kit.core.observation.table import BinTest
from replay_kit.measurements.profiles.earth import Words
from replay_kit.measurements.profiles.frames import tilt

Flags = NDArray[np.int8]
_GOOD, _NOT_EVALUATED, _SUSPECT, _FAIL, _MISSING = (
    np.int8(flag) for flag in (Flag.GOOD, Flag.NOT_EVALUATED, Flag.SUSPECT, Flag.FAIL, Flag.MISSING)
)
# a solution needs so many beams
_BEAMS = 3
# scales a median deviation to the standard deviation of a normal distribution
_MAD = 1.4826
# bins; fewer have no median that one of them could not move
_FEWEST = 4
# numbers up to which exchanges are faster than sorting
_FEW = 9
# bins in the window whose middle one is tested; and the least median deviation [m/s] beside a bin's own error: smooth profiles pass
_OUTLIER_WINDOW, _OUTLIER_FLOOR = 7, 0.1
_NO_SNR = "the ping has neither snr nor noise_floor with amplitude"
#: Columns of pings of one layout, and what is fixed of their instrument.
Profiles = Mapping[str, Any]
#: Suspect and fail: numbers, or arrays that broadcast to the values; None for none.
Limits = tuple[Any, ...]


@np.errstate(all="ignore")
def tested(
    profiles: Profiles, config: MeasurementConfig
) -> tuple[list[BinTest], Flags, NDArray[np.int32]]:
    """Return the results of each test, and the combined flags and reasons of bins, shapes (n, m).

    Args:
        profiles: Result of ``earth.to_earth`` with depth, transducer_depth, vehicle_depth and dive.
        config: Limits of the tests.
    """
    quality, depth = config.quality, profiles["depth"]

    def test(
        name: str, reason: Reason, values: Array, why: Any, least: bool, limits: Limits = ()
    ) -> BinTest:
        why, limits = np.full(len(depth), why, object), limits or quality.limits(name)
        good, flags = why == "", np.full(depth.shape, _NOT_EVALUATED)
        if good.any():
            flags = np.where(good[:, None], graded(values, limits, least), flags)
        if all(limit is None for limit in limits):
            why[:] = "switched off"
        return BinTest(name, reason, flags, why)

    found = [test(*each) for each in _tests(profiles, config)]
    # each bin against those around it that no other test failed
    velocity = profiles["velocity"][..., :2].copy()
    velocity[np.any([test.flags == _FAIL for test in found], axis=0) | ~np.isfinite(depth)] = np.nan
    floor = np.maximum(profiles["error_std"], _OUTLIER_FLOOR)
    ratio = outlyingness(velocity, floor, _OUTLIER_WINDOW)
    few = np.where(np.isfinite(ratio).any(axis=1), "", "too few bins")
    found.append(test("outlier", Reason.OUTLIER, ratio, few, False))
    return found, *_rolled_up(found, profiles, quality.use_suspect)


def _tests(profiles: Profiles, config: MeasurementConfig) -> Sequence[tuple[Any, ...]]:
    """Return the tests of single bins: name, reason, values, reason for missing ones, whether limits are lower bounds.

    The last element are limits that are not in the settings by name.
    """
    quality, dive = config.quality, profiles["dive"]
    east, north = np.moveaxis(profiles["velocity"][..., :2], 2, 0).copy()
    reach, cosine = _reach(profiles, config)
    bottom, transducer = profiles["bottom_range"], profiles["transducer_depth"]
    correlation = "nortek_correlation" if profiles["convention"] == "nortek" else "correlation"
    angle = tilt(profiles["pitch"], profiles["roll"])
    # how an instrument is mounted in a glider, level in the glide or not, no ping says
    tilted = np.where(dive > 0, "not evaluated for a gliding vehicle", "")
    tilted = np.where(np.isfinite(angle), tilted, "the ping has no pitch and roll")
    # at the surface a vehicle rolls in the waves with its bubbles; its depth may be an older one than the ping's own
    depth = np.fmax(profiles["vehicle_depth"], transducer)[:, None]
    derived = "derived from many pings" if profiles["derived"] else ""
    at_surface = [
        config.surface_depth if quality.at_surface == flag else None for flag in ("suspect", "fail")
    ]
    return (
        ("above_surface", Reason.ABOVE_SURFACE, profiles["depth"], "", True, (None, 0.0)),
        (
            "max_speed",
            Reason.GROSS_RANGE,
            np.maximum(np.abs(east), np.abs(north)),
            "",
            False,
            (None, config.max_speed),
        ),
        (
            "bottom",
            Reason.BELOW_BOTTOM,
            reach,
            np.where(np.isfinite(bottom), "", "no bottom track"),
            False,
            (None, (bottom * cosine)[:, None]),
        ),
        (correlation, Reason.LOW_CORRELATION, *_beams(profiles, "correlation"), True),
        ("amplitude", Reason.LOW_AMPLITUDE, *_beams(profiles, "amplitude"), True),
        ("snr", Reason.LOW_SNR, *_snr(profiles), True),
        ("percent_good", Reason.LOW_PERCENT_GOOD, *_percent_good(profiles), True),
        (
            "error_velocity",
            Reason.ERROR_VELOCITY,
            profiles["error_size"],
            profiles["no_error_velocity"],
            False,
        ),
        (
            "speed",
            Reason.HIGH_SPEED,
            np.hypot(east, north),
            np.where(profiles["absolute"], "", "velocity is relative to the platform"),
            False,
        ),
        ("tilt", Reason.TILT, angle[:, None], tilted, False),
        (
            "sidelobe",
            Reason.SIDELOBE,
            reach,
            "" if profiles["orientation"] == "up" else "the instrument looks down",
            False,
            (None, (transducer * cosine)[:, None] if quality.sidelobe else None),
        ),
        (
            "at_surface",
            Reason.AT_SURFACE,
            depth,
            np.where(dive == 0, "no dive yet", derived),
            True,
            tuple(at_surface),
        ),
    )


def _beams(profiles: Profiles, name: str) -> tuple[Array, Words]:
    """Return the decisive beam value of each cell for a field, shape (n, m), and why pings lack it."""
    found = np.full(profiles["depth"].shape, np.nan)
    if name in profiles:
        found = worst_needed(profiles[name])
    return found, profiles[f"no_{name}"]


def _snr(profiles: Profiles) -> tuple[Array, Words]:
    """Return the stated signal-to-noise ratio, else echo amplitude over noise floor [dB]."""
    values, why = _beams(profiles, "snr")
    amplitude, floor, lacks = profiles.get("amplitude"), profiles["noise_floor"], why != ""
    instead: Any = _NO_SNR
    if amplitude is not None and floor.size in (1, amplitude.shape[2]):
        values = np.where(lacks[:, None], worst_needed(amplitude - floor), values)
        instead = np.where(np.isfinite(values).any(axis=1), "", _NO_SNR)
    return values, np.where(lacks, instead, why)


def _percent_good(profiles: Profiles) -> tuple[Array, Words]:
    """Return the percentage of good solutions in each cell, from one number per cell or beam, or Teledyne's four.

    Teledyne's four, for velocities rotated by the instrument, are three-beam solutions, rejected ones, too few beams, and four-beam
    solutions; the first and last are added.
    """
    values = profiles.get("percent_good")
    # of the makers whose instruments turn velocities only Teledyne writes four numbers
    turned = profiles["frame"] != "beam" and profiles["convention"] != "nortek"
    if values is not None and turned and values.shape[2] == 4:
        return values[..., 0] + values[..., 3], profiles["no_percent_good"]
    return _beams(profiles, "percent_good")


def _reach(profiles: Profiles, config: MeasurementConfig) -> tuple[Array, float]:
    """Return the far edge of bins from the transducer, shape (n, m) [m], and the fraction of a boundary's distance free of side lobes.

    The side lobe reaches a boundary before the beam, which contaminates the last 1 - cos(beam angle) of the range, for the widest beam or
    the configured angle.
    """
    distance, size, vectors = profiles["distance"], profiles["cell_size"], profiles["vectors"]
    if not np.isfinite(size) and distance.shape[1] > 1:
        steps = np.diff(distance, axis=1)
        size = _median(np.abs(steps.T), np.isfinite(steps).sum(axis=1))[:, None]
    lowest = 0.0 if vectors is None or not vectors.size else float(np.abs(vectors[:, 2]).min())
    cosine = lowest if 0.0 < lowest <= 1.0 else float(np.cos(np.deg2rad(config.quality.beam_angle)))
    return distance + 0.5 * np.nan_to_num(size), cosine


def graded(values: Array, limits: Limits, least: bool) -> Flags:
    """Return the flags of values against limits; not evaluated for NaN or without any limit.

    Args:
        values: Values of any shape.
        limits: Limits for suspect and fail.
        least: Whether the limits are lower bounds, else upper ones.
    """
    known = np.isfinite(values) & any(limit is not None for limit in limits)
    flags = np.where(known, _GOOD, _NOT_EVALUATED)
    for limit, flag in zip(limits, (_SUSPECT, _FAIL), strict=True):
        if limit is not None:
            flags[values < limit if least else values > limit] = flag
    return flags


def worst_needed(beams: Array) -> Array:
    """Return the decisive value of each cell, shape (..., m): the third best beam, or the worst of fewer.

    A single bad beam of four is detected by the error velocity; NaN if too few beams have a value.

    Args:
        beams: shape (..., m, b), correlation, echo or similar of each beam.
    """
    needed = min(_BEAMS, beams.shape[-1])
    # NaN sorts last, so beams without a number stand behind all others
    return np.asarray(-np.sort(-beams, axis=-1)[..., needed - 1])


@np.errstate(invalid="ignore")
def outlyingness(velocity: Array, floor: Array, window: int) -> Array:
    """Return the distance of each bin from its running median in median deviations, shape (..., m): Hampel filter.

    Deviations are scaled to standard deviations, of the window or the whole profile if larger; the worse component counts. At a profile's
    ends the window is moved inwards. A linear profile gives at most 1.4, a step between two layers 0. NaN if the bin or all but three of
    its window are missing.

    Args:
        velocity: shape (..., m, 2) [m/s]; NaN where missing or failed.
        floor: shape (..., m) [m/s], least deviation, so that noise of a smooth profile is no outlier.
        window: Odd number of bins in a window; a shorter profile is one window.
    """
    # components and cells first, so that what is compared with each other is whole arrays
    each = np.ascontiguousarray(np.moveaxis(velocity, (-1, -2), (0, 1)))
    finite, m = np.asarray(np.isfinite(each).all(axis=0)), each.shape[1]
    each, n_finite = np.where(finite, each, np.inf), finite.sum(axis=0)
    # the windows that there are, and that of each bin; of a shorter profile all
    width = min(window, m)
    around = [each[:, k : k + m - width + 1] for k in range(width)]
    window_of = np.clip(np.arange(m) - window // 2, 0, m - width)
    count = np.sum([np.isfinite(one[0]) for one in around], axis=0)
    middle = _median(around, count)
    spread = _median([np.abs(one - middle) for one in around], count)[:, window_of]
    apart = np.abs(each - middle[:, window_of])
    # the few bins of a window often lie close together by chance: what is usual in the profile counts too
    usual = _median(apart.swapaxes(0, 1), n_finite)[:, None]
    scale = np.maximum(_MAD * np.maximum(spread, usual), np.moveaxis(floor, -1, 0))
    known = finite & (count[window_of] >= _FEWEST) & (n_finite >= _FEWEST)
    return np.moveaxis(np.where(known, np.maximum(*apart / scale), np.nan), 0, -1)


def _median(values: Sequence[Array] | Array, count: Indices) -> Array:
    """Return medians of the ``count`` least numbers along the first axis, faster than numpy's for few."""
    if len(values) > _FEW:
        ordered = np.sort(values, axis=0)
    else:
        # the lower half, by exchanges
        few = [*values]
        for least, one in combinations(range(len(few)), 2):
            if 2 * least <= len(few):
                both = few[least], few[one]
                few[least], few[one] = np.minimum(*both), np.maximum(*both)
        ordered = np.array(few[: len(few) // 2 + 1])
    places = np.arange(ordered[0].size).reshape(ordered.shape[1:])
    below, above = (
        ordered.take(at * places.size + places)
        for at in (np.maximum(count - 1, 0) // 2, np.minimum(count // 2, len(ordered) - 1))
    )
    return np.asarray(0.5 * (below + above))


def _rolled_up(
    tests: Sequence[BinTest], profiles: Profiles, use_suspect: bool
) -> tuple[Flags, NDArray[np.int32]]:
    """Return each bin's worst flag, and the reasons of all tests with suspect or fail.

    A bin without a value is missing. Suspect bins fail if they are not to be used.
    """
    present = all_along(np.isfinite(profiles["velocity"][..., :2]))
    malformed = ~np.isfinite(profiles["depth"])
    reasons = np.int32(Reason.MALFORMED) * malformed + np.int32(Reason.MISSING) * ~present
    missing, flags = reasons != 0, np.full(reasons.shape, _GOOD)
    for test in tests:
        bad = test.flags >= _SUSPECT
        if bad.any():
            flags = np.where(bad, np.maximum(flags, test.flags), flags)
            reasons |= np.int32(test.reason) * bad
    if not use_suspect:
        flags[flags == _SUSPECT] = _FAIL
    flags[missing] = _MISSING
    return flags, reasons
