"""The result of ``plan`` made again from what it records, for ``verify``."""

from collections.abc import Mapping
from pathlib import Path

from replay_kit.config.run import RunConfig
from replay_kit.core.errors import PlanError
from replay_kit.results.compare import Recorded
from replay_kit.workflows.planning.inputs import planned_on
from replay_kit.workflows.planning.learning import Learnt, make_learning
from replay_kit.workflows.planning.learning_outputs import write_learning
from replay_kit.workflows.planning.mission import PlannedMission, make_mission
from replay_kit.workflows.planning.outputs import write_mission
from replay_kit.workflows.planning.record import recorded_request
from replay_kit.workflows.planning.request import checked
from replay_kit.workflows.planning.together import make_together
from replay_kit.workflows.replay.inputs.provenance import PLAN_RECORD


def plan_again(recorded: Recorded, config: RunConfig, found: Mapping[str, Path], out: Path) -> None:
    """Plan what a result was planned for, and write it as ``plan`` does.

    Args:
        recorded: What the result says of how it was made.
        config: Its configuration.
        found: Its inputs, by the keys of their record.
        out: The new result.

    Raises:
        ReplayKitError: The record is damaged, or there is no such plan any more.
    """
    request = checked(recorded_request(recorded.metadata[PLAN_RECORD], found))
    config = config.model_copy(update={"plan": request})
    planned: PlannedMission | Learnt
    if request.glider:
        each = make_together(request, config.planner).planned
        if request.of_glider is None or request.of_glider not in each:
            raise PlanError(
                f"{PLAN_RECORD}: expected the plan of a glider, one of {', '.join(each)}, got {request.of_glider}; plan again"
            )
        planned = each[request.of_glider]
    elif request.learns:
        planned = make_learning(request, config.planner)
    else:
        on = planned_on(request, config.planner)
        planned = make_mission(request, config.planner, on)
    if isinstance(planned, PlannedMission):
        write_mission(out, False, planned, config)
    else:
        write_learning(out, False, planned, config)
