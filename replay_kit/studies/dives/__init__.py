"""``experiment dives``: each dive of real logs predicted from the dives before it."""

from replay_kit.studies.dives.read import read_dives
from replay_kit.studies.dives.run import DivesResult, run_dives

__all__ = ["DivesResult", "read_dives", "run_dives"]
