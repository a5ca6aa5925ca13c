"""``experiment accuracy``: the error of each estimation method against the number of pings."""

from replay_kit.studies.accuracy.made import Sources, read_sources
from replay_kit.studies.accuracy.methods import METHODS
from replay_kit.studies.accuracy.page import FILES, print_accuracy, to_json, write_accuracy
from replay_kit.studies.accuracy.run import AccuracyJob, AccuracyResult, run_accuracy

__all__ = [
    "FILES",
    "METHODS",
    "AccuracyJob",
    "AccuracyResult",
    "Sources",
    "print_accuracy",
    "read_sources",
    "run_accuracy",
    "to_json",
    "write_accuracy",
]
