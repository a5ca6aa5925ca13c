"""The result of ``plan`` made again from what it records, for ``verify``."""

from collections.abc import Mapping
from pathlib import Path

from replay_kit.config.run import RunConfig
from replay_kit.results import Recorded
from replay_kit.workflows.planning.learning import make_learning
from replay_kit.workflows.planning.learning_outputs import write_learning
from replay_kit.workflows.planning.mission import make_mission
from replay_kit.workflows.planning.outputs import write_mission
from replay_kit.workflows.planning.record import recorded_request
from replay_kit.workflows.planning.request import checked
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
    if request.learns:
        write_learning(out, False, make_learning(request, config.planner), config)
    else:
        write_mission(out, False, make_mission(request, config.planner), config)
