"""Log formats: ``open_log`` chooses the reader by what a file holds, ``merge`` puts several logs in one order."""

from replay_kit.logs.merge import Merge, merge
from replay_kit.logs.registry import open_log

__all__ = ["Merge", "merge", "open_log"]
