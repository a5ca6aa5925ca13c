"""What a fleet will take: time and memory of each mission from growth measured once, without a single update.

The figures are processor seconds of one core (AMD EPYC) with one BLAS thread; where the program becomes faster, they are measured again and
replaced here.
"""

import heapq
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from rich.console import Console

from replay_kit.core.arrays import IN_MEMORY
from replay_kit.show.text import print_lines, print_table
from replay_kit.workflows.fleet.cluster import Cluster
from replay_kit.workflows.fleet.missions import Mission
from replay_kit.workflows.fleet.run import Outcome, failure
from replay_kit.workflows.planning.adapters import planner_of
from replay_kit.workflows.replay.checks import check_inputs

#: Of the set-up: nodes a level, seconds, memory [MB]; 8 levels, 50 members, 300 modes (``python -m tests.benchmarks size``).
SET_UP = (
    (527, 2.4, 102.0),
    (900, 3.5, 124.0),
    (3600, 6.2, 255.0),
    (14_400, 27.1, 772.0),
    (57_600, 136.1, 3311.0),
)
#: For each value of a component beyond those 8 levels and 50 members [s], from 120 x 120 x 30 x 50 and 240 x 240 x 50 x 95.
VALUE_S = 6e-7
#: For reading, checking, updating with and writing one profile [s]: 450 of the sample survey, and 8 ms with 2,400 weights.
PROFILE_S = 0.0098
# What the interpreter and the libraries take before the first array [MB].
_BASE_MB = 250.0


@dataclass(frozen=True, slots=True)
class Expected:
    """What a mission will take.

    Attributes:
        mission: Its name.
        profiles: That its logs give.
        nodes: Of the forecast used, a level.
        levels: Of the forecast used.
        set_up_s: For basis and prior, where the store does not have them.
        replay_s: For the rest.
        memory_mb: At the peak.
    """

    mission: str
    profiles: int
    nodes: int
    levels: int
    set_up_s: float
    replay_s: float
    memory_mb: float


def expected_of(mission: Mission) -> Expected | Outcome:
    """Return what a mission will take; of one that cannot be replayed, why. Its forecast and logs are read to their end."""
    try:
        return _expected(mission)
    except Exception as error:
        return failure(mission.name, error)


def _expected(mission: Mission) -> Expected:
    job, config = mission.job, mission.config
    inputs = check_inputs(job, config, planner_of)
    ensemble, profiles = inputs.forecasts.ensemble, inputs.profiles
    nodes, levels = math.prod(ensemble.grid.east.shape), int(ensemble.grid.levels.size)
    set_up_s, memory = (grown(nodes, [(size, row[k]) for size, *row in SET_UP]) for k in range(2))
    values = nodes * max(levels * ensemble.n_members - 8 * 50, 0)
    return Expected(
        mission=mission.name,
        profiles=profiles,
        nodes=nodes,
        levels=levels,
        set_up_s=set_up_s + VALUE_S * values,
        replay_s=profiles * PROFILE_S,
        memory_mb=_BASE_MB + memory + 2e-6 * min(ensemble.velocity.nbytes, IN_MEMORY),
    )


def grown(size: float, measured: Sequence[tuple[float, float]]) -> float:
    """Return a figure at a size, by powers of the size between the sizes measured and, with the nearest two's exponent, beyond them.

    Args:
        size: At least 1.
        measured: At least two sizes, increasing, with their figures above 0.
    """
    at = next((k for k in range(1, len(measured)) if size <= measured[k][0]), len(measured) - 1)
    (size0, low), (size1, high) = measured[at - 1], measured[at]
    exponent = math.log(high / low) / math.log(size1 / size0)
    return float(low * (size / size0) ** exponent)


def in_all_s(each: Sequence[Expected], workers: int) -> float:
    """Return how long missions take, given in their order to workers as these become free."""
    free = [0.0] * workers
    for one in each:
        heapq.heappush(free, heapq.heappop(free) + one.set_up_s + one.replay_s)
    return max(free)


def expected_fleet(
    missions: Sequence[Mission], cluster: Cluster
) -> tuple[list[Expected], list[Outcome]]:
    """Return what the missions that can be replayed will take, and why others cannot; computed by the workers, which so read the data."""
    answers = list(cluster.starmap(expected_of, ((mission,) for mission in missions)))
    return [one for one in answers if isinstance(one, Expected)], [
        one for one in answers if isinstance(one, Outcome)
    ]


def expected_json(
    each: Sequence[Expected], failed: Sequence[Outcome], workers: int
) -> Mapping[str, Any]:
    """Return the JSON object of ``--json``."""
    return {
        "status": "dry run",
        "exit_code": failed[0].exit_code if failed else 0,
        "workers": workers,
        "seconds": in_all_s(each, workers),
        "memory_mb": workers * max((one.memory_mb for one in each), default=0.0),
        "missions": [asdict(one) for one in each],
        "failed": {one.name: one.failed for one in failed},
    }


def print_expected(
    each: Sequence[Expected], failed: Sequence[Outcome], workers: int, console: Console
) -> None:
    """Print what missions will take, and why others cannot be replayed."""
    columns = ("mission", "profiles", "nodes", "levels", "set-up [s]", "replay [s]", "memory [MB]")
    rows = [
        (
            o.mission,
            str(o.profiles),
            str(o.nodes),
            str(o.levels),
            f"{o.set_up_s:.1f}",
            f"{o.replay_s:.1f}",
            f"{o.memory_mb:.0f}",
        )
        for o in each
    ]
    print_table(console, "Expected", columns, rows)
    print_lines(console, [f"FAILED: {one.name}: {one.failed}" for one in failed])
    largest = max((one.memory_mb for one in each), default=0.0)
    print_lines(
        console,
        [
            f"{len(each)} missions on {workers} workers: about {in_all_s(each, workers):.0f} s or less, where a basis is shared; up to "
            f"{largest:.0f} MB a worker. Nothing was written."
        ],
    )
