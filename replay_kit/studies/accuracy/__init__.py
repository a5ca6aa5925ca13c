"""``experiment accuracy``: the error of each estimation method against the number of pings."""

from replay_kit.studies.accuracy.methods import METHODS
from replay_kit.studies.accuracy.run import AccuracyJob, AccuracyResult, run_accuracy

__all__ = ["METHODS", "AccuracyJob", "AccuracyResult", "run_accuracy"]
