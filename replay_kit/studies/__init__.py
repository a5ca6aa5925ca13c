"""Experiments: the estimator against its baselines on twins of a known truth."""

from replay_kit.studies.accuracy import METHODS, AccuracyJob, AccuracyResult, AccuracyRow, run_accuracy
from replay_kit.studies.accuracy_text import to_json

__all__ = ["METHODS", "AccuracyJob", "AccuracyResult", "AccuracyRow", "run_accuracy", "to_json"]
