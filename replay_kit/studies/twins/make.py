"""Log of a twin experiment from a vehicle and its instrument."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from replay_kit.core.errors import ConfigError
from replay_kit.core.files.paths import check_paths
from replay_kit.core.grid import Ensemble
from replay_kit.logs.mcap.writer import write_mcap_log
from replay_kit.studies.twins.adcp import measured_on
from replay_kit.studies.twins.field import Field, build_field
from replay_kit.studies.twins.glider import PING_STEPS, STEP_S, Schedule
from replay_kit.studies.twins.glider import mission as glider_mission
from replay_kit.studies.twins.vehicle import EPOCH_NS, Mission, survey

Vehicle = Literal["vessel", "glider"]
_USUAL_S = float(STEP_S * PING_STEPS)


@dataclass(frozen=True, slots=True)
class Twin:
    """Settings of a simulated log.

    Attributes:
        vehicle: ``vessel``, a survey of random positions, or ``glider``, a sawtooth along a course.
        pings: Number of pings.
        noise: Standard deviation of each velocity component [m/s].
        seed: Seed of positions and noise, independent of the following settings.
        interval_s: Ping interval of a glider [s]; a multiple of its step of 120 s.
    """

    vehicle: Vehicle
    pings: int
    noise: float
    seed: int
    interval_s: float = _USUAL_S

    def check(self) -> None:
        """Raise ConfigError if a value cannot be simulated or does not fit the vehicle."""
        if self.vehicle not in get_args(Vehicle):
            raise ConfigError(
                f"vehicle: expected {' or '.join(get_args(Vehicle))}, got '{self.vehicle}'"
            )
        if self.pings < 1 or not (np.isfinite(self.noise) and self.noise >= 0.0) or self.seed < 0:
            raise ConfigError(
                f"twin: expected pings >= 1, noise >= 0 and seed >= 0, got pings {self.pings}, noise {self.noise}, seed {self.seed}"
            )
        steps = self.interval_s / STEP_S
        if not (steps >= 1.0 and steps.is_integer()):
            raise ConfigError(
                f"twin: expected an interval of {STEP_S} s times a whole number, got {self.interval_s:g}"
            )
        if self.vehicle != "glider" and self.interval_s != _USUAL_S:
            raise ConfigError(
                f"twin: an interval between pings is a glider's, got vehicle '{self.vehicle}'"
            )


def make_twin(
    truth: Ensemble | Sequence[Ensemble], twin: Twin, out: Path, overwrite: bool = False
) -> Mission:
    """Write the log of a simulated vehicle in a truth, and return the mission; equal arguments give equal bytes.

    Args:
        truth: Ensemble of one, or several at increasing times with linear changes between them.
        twin: Vehicle, survey, and errors of the instrument.
        out: Log, ``.mcap``.
        overwrite: Whether an existing log is replaced.

    Raises:
        ConfigError: An argument is invalid, or the output exists.
        ForecastError: The truth does not cover the track.
    """
    if out.suffix.lower() != ".mcap":
        raise ConfigError(f"{out}: a twin's log is .mcap, got '{out.suffix}'; choose this ending")
    check_paths([], [out], overwrite)
    twin.check()
    rng = np.random.default_rng(twin.seed)
    truths = (truth,) if isinstance(truth, Ensemble) else tuple(truth)
    field = build_field(*truths)
    mission = _fly(field, twin, EPOCH_NS if truths[0].time_ns is None else truths[0].time_ns, rng)
    write_mcap_log(out, measured_on(mission, field, twin.noise, rng).messages())
    return mission


def _fly(field: Field, twin: Twin, start_ns: int, rng: np.random.Generator) -> Mission:
    if twin.vehicle == "vessel":
        return survey(field, twin.pings, start_ns, rng)
    # the samples' logs end with the last ping
    schedule = Schedule(int(twin.interval_s) // STEP_S, to_the_end=twin.interval_s != _USUAL_S)
    return glider_mission(field, twin.pings, start_ns, rng, schedule=schedule)
