"""``experiment dives``: each dive of real logs predicted from the dives before it."""

from replay_kit.studies.dives.page import FILES, print_dives, to_json, write_dives
from replay_kit.studies.dives.read import Dive, read_dives
from replay_kit.studies.dives.run import DivesResult, run_dives

__all__ = [
    "FILES",
    "Dive",
    "DivesResult",
    "print_dives",
    "read_dives",
    "run_dives",
    "to_json",
    "write_dives",
]
