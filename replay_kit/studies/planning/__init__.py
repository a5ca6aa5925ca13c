"""``experiment planning``: plans made on estimates and flown in truths that the estimates do not know."""

from replay_kit.studies.planning.calls import Calls
from replay_kit.studies.planning.job import PlanningJob
from replay_kit.studies.planning.replanned import NAME as WITHOUT_TRUTH
from replay_kit.studies.planning.run import PlanningResult, run_planning
from replay_kit.studies.planning.studies import STUDIES
from replay_kit.studies.planning.write import print_planning, replaced_files, to_json, write_planning

__all__ = [
    "STUDIES",
    "WITHOUT_TRUTH",
    "Calls",
    "PlanningJob",
    "PlanningResult",
    "print_planning",
    "replaced_files",
    "run_planning",
    "to_json",
    "write_planning",
]
