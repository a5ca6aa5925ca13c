"""Studies on simulated glider missions, with a member of the ensemble left out as the truth."""

from replay_kit.studies.missions.job import STUDIES, MissionJob
from replay_kit.studies.missions.page import FILES, write_missions
from replay_kit.studies.missions.report import print_missions, to_csv, to_json
from replay_kit.studies.missions.run import run_missions

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
