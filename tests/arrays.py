"""Twins of gliders that fly distinct courses through one truth."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from replay_kit.core.grid import Ensemble
from replay_kit.logs.mcap.writer import write_mcap_log
from replay_kit.studies.twins.adcp import measured_on
from replay_kit.studies.twins.field import build_field
from replay_kit.studies.twins.glider import Schedule, missions
from replay_kit.studies.twins.vehicle import EPOCH_NS, Mission
from tests.faulty import SOUND, Faults, messages_of

# m/s, a component; that of a mean current that states none, as a replay takes it
_MEAN_CURRENT_STD = 0.02


def course(number: int, of: int) -> tuple[tuple[float, float], ...]:
    """Return the course of one of some gliders: a triangle about the middle of the grid, each turned against the others."""
    angles = 2.0 * np.pi * (number / of + np.array([0.0, 0.4, 0.75]))
    return tuple(
        (0.5 + 0.3 * float(np.sin(angle)), 0.5 + 0.3 * float(np.cos(angle))) for angle in angles
    )


def with_errors(mission: Mission, rng: np.random.Generator) -> Mission:
    """Return a mission whose dives' mean currents err as a replay takes them to."""
    dives = tuple(
        replace(dive, current=(dive.current[0] + float(east), dive.current[1] + float(north)))
        for dive, (east, north) in zip(
            mission.dives, _MEAN_CURRENT_STD * rng.normal(size=(len(mission.dives), 2)), strict=True
        )
    )
    return replace(mission, dives=dives)


def write_array(
    folder: Path,
    truth: Ensemble,
    count: int,
    pings: int = 120,
    dac_only: bool = False,
    faults: dict[int, Faults] | None = None,
    late_s: int = 0,
) -> dict[str, Path]:
    """Write the logs of some gliders, and return them by the vehicles' names, ``sg1`` first.

    Args:
        folder: Where to.
        truth: The sea.
        count: Of gliders.
        pings: Of each, one in ten minutes.
        dac_only: Whether they have mean currents alone.
        faults: Of the instrument of some, by number from 0.
        late_s: How much later each begins than the one before [s].
    """
    field, logs = build_field(truth), {}
    start_ns = EPOCH_NS if truth.time_ns is None else truth.time_ns
    rngs = [np.random.default_rng([0, number]) for number in range(count)]
    schedules = [Schedule(to_the_end=True, course=course(k, count)) for k in range(count)]
    starts_ns = [start_ns + 10**9 * (late_s * number) for number in range(count)]
    all_flown = missions(field, pings, starts_ns, rngs, schedules)
    for number, (one, rng) in enumerate(zip(all_flown, rngs, strict=True)):
        flight = measured_on(with_errors(one, rng), field, 0.09, rng)
        path = logs[f"sg{number + 1}"] = folder / f"sg{number + 1}.mcap"
        found = (faults or {}).get(number, SOUND)
        write_mcap_log(path, messages_of(flight, found, number, pings=not dac_only))
    return logs
