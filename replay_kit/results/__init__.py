"""Values to result files and back: the result MCAP, its message schemas and its read-back check."""

from replay_kit.results.compare import Difference, Recorded, first_difference, read_recorded
from replay_kit.results.digest import Digest
from replay_kit.results.journal import Journal, read_journal
from replay_kit.results.mcap_reader import read_estimate
from replay_kit.results.mcap_writer import ResultWriter
from replay_kit.results.opened import Result, open_result
from replay_kit.results.schemas import CONTRACT_VERSION

__all__ = [
    "CONTRACT_VERSION",
    "Difference",
    "Digest",
    "Journal",
    "Recorded",
    "Result",
    "ResultWriter",
    "first_difference",
    "open_result",
    "read_estimate",
    "read_journal",
    "read_recorded",
]
