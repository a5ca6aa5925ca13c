"""``experiment missions``: simulated glider missions, with a member of the ensemble left out as the truth."""

from replay_kit.studies.missions.run import run_missions
from replay_kit.studies.missions.scene import STUDIES, MissionJob

__all__ = ["STUDIES", "MissionJob", "run_missions"]
