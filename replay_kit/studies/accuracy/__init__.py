"""``experiment accuracy``: the error of each estimation method against the number of pings."""

from replay_kit.studies.accuracy.run import AccuracyJob, AccuracyResult, run_accuracy
from replay_kit.studies.scoring import METHODS

__all__ = ["METHODS", "AccuracyJob", "AccuracyResult", "run_accuracy"]
