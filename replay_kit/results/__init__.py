"""Values to result files and back: the result MCAP, its message schemas and its read-back check."""

from replay_kit.results.mcap_reader import read_estimate
from replay_kit.results.mcap_writer import ResultWriter
from replay_kit.results.schemas import CONTRACT_VERSION

__all__ = ["CONTRACT_VERSION", "ResultWriter", "read_estimate"]
