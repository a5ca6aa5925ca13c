"""Result files: the result MCAP, its message schemas, writing, reading and checks."""

from typing import TYPE_CHECKING

from replay_kit.core.extensions import on_demand

if TYPE_CHECKING:
    from replay_kit.results.differences import Difference, Recorded, difference, read_recorded
    from replay_kit.results.mcap.schemas import CONTRACT_VERSION
    from replay_kit.results.mcap.writer import ResultWriter
    from replay_kit.results.reader import ResultReader

__all__ = [
    "CONTRACT_VERSION",
    "Difference",
    "Recorded",
    "ResultReader",
    "ResultWriter",
    "difference",
    "read_recorded",
]

# messages in words need none of the libraries that read and write files
__getattr__ = on_demand(__name__, __file__)
