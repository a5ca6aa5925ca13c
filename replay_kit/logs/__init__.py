"""Log formats: ``open_logs`` chooses readers by what files and folders hold, ``merge`` puts several logs in one order."""

from replay_kit.logs.formats import FORMATS, LogFormat, open_log, open_logs
from replay_kit.logs.merge import Merge, merge

__all__ = ["FORMATS", "LogFormat", "Merge", "merge", "open_log", "open_logs"]
