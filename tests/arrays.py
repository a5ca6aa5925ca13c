"""Twins of gliders that fly through one truth from distinct corners."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from replay_kit.core.grid import Ensemble
from replay_kit.logs.mcap.writer import write_mcap_log
from replay_kit.studies.twins.field import build_field
from replay_kit.studies.twins.mission import dives
from tests.faulty import SOUND, Faults, measured_on, messages_of

# m/s, a component; that of a mean current that states none, as a replay takes it
_MEAN_CURRENT_STD = 0.02


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
    for number in range(count):
        # the first three begin at different corners
        rng = np.random.default_rng([5, number])
        flown = dives(field, pings, rng)
        errors = _MEAN_CURRENT_STD * rng.normal(size=flown.current.shape)
        later_ns = flown.time_ns + 10**9 * (late_s * number)
        flown = replace(flown, time_ns=later_ns, current=flown.current + errors)
        flight = measured_on(flown, field, 0.09, rng)
        path = logs[f"sg{number + 1}"] = folder / f"sg{number + 1}.mcap"
        found = (faults or {}).get(number, SOUND)
        write_mcap_log(path, messages_of(flight, found, number, pings=not dac_only))
    return logs
