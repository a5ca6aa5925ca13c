"""A twin experiment's log: a vehicle, its instrument, a carrier."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from replay_kit.core.errors import ConfigError
from replay_kit.core.grid import Ensemble
from replay_kit.logs.mavlink.writer import write_tlog
from replay_kit.logs.mcap.writer import write_mcap_log
from replay_kit.studies.twins.adcp import AdcpSettings, measure
from replay_kit.studies.twins.faults import Faults, as_logged
from replay_kit.studies.twins.field import Field, build_field
from replay_kit.studies.twins.glider import PING_STEPS, STEP_S, Schedule
from replay_kit.studies.twins.glider import mission as glider_mission
from replay_kit.studies.twins.messages import Record, mission_messages
from replay_kit.studies.twins.vehicle import EPOCH_NS, Mission, survey

Vehicle = Literal["vessel", "glider"]
_WRITERS = {".mcap": write_mcap_log, ".tlog": write_tlog}


@dataclass(frozen=True, slots=True)
class Options:
    """What is simulated beyond the plain mission.

    Attributes:
        faults: Of the instrument.
        interval_s: From one ping of a glider to the next [s]; a multiple of its step of 120 s.
        dac_only: Whether the log has a glider's positions and mean currents, but no pings.
    """

    faults: Faults = field(default_factory=Faults)
    interval_s: float = float(STEP_S * PING_STEPS)
    dac_only: bool = False


@dataclass(frozen=True, slots=True)
class TwinSummary:
    """What a simulated log holds.

    Attributes:
        out: The log.
        bytes: Its size.
        pings: Number of pings.
        bins: Number of bins with a velocity.
        dives: Number of dives.
        start_ns: First ping [ns, UTC].
        end_ns: Last ping [ns, UTC].
        duration: From the first ping to the last [s].
        distance: Along the true track between pings [m].
    """

    out: Path
    bytes: int
    pings: int
    bins: int
    dives: int
    start_ns: int
    end_ns: int
    duration: float
    distance: float


def make_twin(
    truth: Ensemble | Sequence[Ensemble],
    vehicle: Vehicle,
    pings: int,
    noise: float,
    seed: int,
    out: Path,
    overwrite: bool = False,
    options: Options = Options(),
) -> TwinSummary:
    """Write the log of a vehicle that measured a truth, and return what is in it; the same arguments give the same bytes.

    Args:
        truth: An ensemble of one, or several of growing times, between which the sea changes linearly.
        vehicle: ``vessel``, a survey of random places, or ``glider``, a sawtooth along a course.
        pings: Number of pings.
        noise: Standard deviation of each velocity component [m/s].
        seed: Of the places and of the noise.
        out: ``.mcap`` or ``.tlog``.
        overwrite: Whether an existing log is replaced.
        options: What else is simulated; by themselves they change neither the places nor the noise.

    Raises:
        ConfigError: A bad argument, or the output exists.
        ForecastError: The truth cannot be sampled along the track.
    """
    writer = _WRITERS.get(out.suffix.lower())
    if writer is None:
        raise ConfigError(f"{out}: a twin's log is .mcap or .tlog, got '{out.suffix}'; choose one of these endings")
    if vehicle not in get_args(Vehicle):
        raise ConfigError(f"vehicle: expected {' or '.join(get_args(Vehicle))}, got '{vehicle}'")
    if pings < 1 or not (np.isfinite(noise) and noise >= 0.0) or seed < 0:
        raise ConfigError(f"twin: expected pings >= 1, noise >= 0 and seed >= 0, got pings {pings}, noise {noise}, seed {seed}")
    if out.exists() and not overwrite:
        raise ConfigError(f"{out}: exists; choose another name or give --overwrite")
    _check(options, vehicle, out)
    rng = np.random.default_rng(seed)
    truths = (truth,) if isinstance(truth, Ensemble) else tuple(truth)
    sea, settings = build_field(*truths), AdcpSettings(noise=noise)
    mission = _fly(sea, vehicle, pings, EPOCH_NS if truths[0].time_ns is None else truths[0].time_ns, rng, options)
    track = mission.pings
    measured = measure(sea, track, settings, rng)
    velocity, platform = as_logged(measured, track, sea.grid.projection, options.faults, seed)
    writer(out, mission_messages(mission, None if options.dac_only else Record(velocity, settings, options.faults, platform)))
    return TwinSummary(
        out,
        out.stat().st_size,
        0 if options.dac_only else pings,
        0 if options.dac_only else int(np.isfinite(velocity).all(axis=-1).sum()),
        len(mission.dives),
        int(track.time_ns[0]),
        int(track.time_ns[-1]),
        float(track.time_ns[-1] - track.time_ns[0]) / 1e9,
        float(np.hypot(np.diff(track.east), np.diff(track.north)).sum()),
    )


def _check(options: Options, vehicle: Vehicle, out: Path) -> None:
    """Raise ConfigError when options do not fit the vehicle or the log."""
    options.faults.check()
    steps = options.interval_s / STEP_S
    if not (steps >= 1.0 and steps.is_integer()):
        raise ConfigError(f"twin: expected an interval of {STEP_S} s times a whole number, got {options.interval_s:g}")
    if vehicle != "glider" and (options.dac_only or options.interval_s != Options().interval_s):
        raise ConfigError(f"twin: mean currents alone and an interval between pings are a glider's, got vehicle '{vehicle}'")
    if out.suffix.lower() == ".tlog" and (options.dac_only or options.faults.platform_std is not None):
        raise ConfigError(f"{out}: a telemetry log holds neither mean currents nor a platform's velocity; choose .mcap")


def _fly(sea: Field, vehicle: Vehicle, pings: int, start_ns: int, rng: np.random.Generator, options: Options) -> Mission:
    if vehicle == "vessel":
        return survey(sea, pings, start_ns, rng)
    # the samples' logs end with the last ping
    schedule = Schedule(int(options.interval_s) // STEP_S, to_the_end=options != Options())
    return glider_mission(sea, pings, start_ns, rng, schedule=schedule)
