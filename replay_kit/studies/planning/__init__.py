"""``experiment planning``: plans made on estimates and flown in truths that the estimates do not know."""

from replay_kit.studies.planning.job import PlanningJob
from replay_kit.studies.planning.run import STUDIES, run_planning

__all__ = ["STUDIES", "PlanningJob", "run_planning"]
