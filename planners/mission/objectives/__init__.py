"""The objectives of missions, a file each: ``replay_kit/core/objective.py`` lists their names."""

from pkgutil import resolve_name
from typing import get_args

from planners.mission.objectives.objective import Objective
from replay_kit.core.objective import ObjectiveName

OBJECTIVES: dict[str, Objective] = {
    name: resolve_name(f"{__name__}.{name}:OBJECTIVE") for name in get_args(ObjectiveName)
}
