"""The studies by name: a new one is one more line here."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from replay_kit.studies.planning.glides import glides
from replay_kit.studies.planning.infeasible import infeasible
from replay_kit.studies.planning.job import PlanningJob
from replay_kit.studies.planning.masked import masked
from replay_kit.studies.planning.missions import missions
from replay_kit.studies.planning.replanned import replanning
from replay_kit.studies.planning.scenarios import scenarios
from replay_kit.studies.planning.told import Told
from replay_kit.studies.planning.world import AVERAGED, METHODS, TRUTH, World

_FLOWS = len((TRUTH, AVERAGED, *METHODS))


@dataclass(frozen=True, slots=True)
class Study:
    """A study.

    Attributes:
        run: Makes it; calls ``world.say`` once for each of its steps.
        steps: How many steps a job has.
    """

    run: Callable[[World], Told]
    steps: Callable[[PlanningJob], int]


STUDIES: Mapping[str, Study] = {
    "glides": Study(glides, lambda job: _FLOWS * job.pairs),
    "missions": Study(missions, lambda job: _FLOWS * job.pairs),
    "scenarios": Study(scenarios, lambda job: job.scenarios),
    "masked": Study(masked, lambda job: job.masks),
    "infeasible": Study(infeasible, lambda job: 10),
    "replanning": Study(replanning, lambda job: job.replans),
}
