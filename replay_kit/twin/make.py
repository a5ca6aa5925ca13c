"""A twin experiment's log: a vehicle, its instrument, a carrier."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from replay_kit.errors import ConfigError
from replay_kit.logs.mcap_log_writer import write_mcap_log
from replay_kit.logs.tlog_writer import write_tlog
from replay_kit.twin.adcp import AdcpSettings, measure
from replay_kit.twin.field import Field, build_field
from replay_kit.twin.glider import mission as glider_mission
from replay_kit.twin.messages import mission_messages
from replay_kit.twin.vehicle import EPOCH_NS, Mission, survey
from replay_kit.types import Ensemble

Vehicle = Literal["vessel", "glider"]
_WRITERS = {".mcap": write_mcap_log, ".tlog": write_tlog}
_MISSIONS: dict[str, Callable[[Field, int, int, np.random.Generator], Mission]] = {"vessel": survey, "glider": glider_mission}


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


def make_twin(truth: Ensemble, vehicle: Vehicle, pings: int, noise: float, seed: int, out: Path, overwrite: bool = False) -> TwinSummary:
    """Write the log of a vehicle that measured a truth, and return what is in it; the same arguments give the same bytes.

    Args:
        truth: An ensemble of one.
        vehicle: ``vessel``, a survey of random places, or ``glider``, a sawtooth along a course.
        pings: Number of pings.
        noise: Standard deviation of each velocity component [m/s].
        seed: Of the places and of the noise.
        out: ``.mcap`` or ``.tlog``.
        overwrite: Whether an existing log is replaced.

    Raises:
        ConfigError: A bad argument, or the output exists.
        ForecastError: The truth cannot be sampled along the track.
    """
    writer = _WRITERS.get(out.suffix)
    if writer is None:
        raise ConfigError(f"{out}: a twin's log is .mcap or .tlog, got '{out.suffix}'; choose one of these endings")
    if vehicle not in _MISSIONS:
        raise ConfigError(f"vehicle: expected {' or '.join(_MISSIONS)}, got '{vehicle}'")
    if pings < 1 or not (np.isfinite(noise) and noise >= 0.0) or seed < 0:
        raise ConfigError(f"twin: expected pings >= 1, noise >= 0 and seed >= 0, got pings {pings}, noise {noise}, seed {seed}")
    if out.exists() and not overwrite:
        raise ConfigError(f"{out}: exists; choose another name or give --overwrite")
    rng = np.random.default_rng(seed)
    field, settings = build_field(truth), AdcpSettings(noise=noise)
    mission = _MISSIONS[vehicle](field, pings, EPOCH_NS if truth.time_ns is None else truth.time_ns, rng)
    track = mission.pings
    velocity = measure(field, track, settings, rng)
    writer(out, mission_messages(mission, velocity, settings))
    return TwinSummary(
        out,
        out.stat().st_size,
        pings,
        int(np.isfinite(velocity).all(axis=-1).sum()),
        len(mission.dives),
        int(track.time_ns[0]),
        int(track.time_ns[-1]),
        float(track.time_ns[-1] - track.time_ns[0]) / 1e9,
        float(np.hypot(np.diff(track.east), np.diff(track.north)).sum()),
    )
