"""Studies on simulated glider missions, with a member of the ensemble left out as the truth."""

from replay_kit.studies.missions.page import FILES, print_missions, to_csv, to_json, write_missions
from replay_kit.studies.missions.run import run_missions
from replay_kit.studies.missions.scene import STUDIES, MissionJob

__all__ = [
    "FILES",
    "STUDIES",
    "MissionJob",
    "print_missions",
    "run_missions",
    "to_csv",
    "to_json",
    "write_missions",
]
