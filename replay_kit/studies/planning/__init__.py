"""``experiment planning``: missions planned on estimates and flown in truths that the estimates do not know."""

from replay_kit.studies.planning.odds import PlanningJob, run_planning

__all__ = ["PlanningJob", "run_planning"]
