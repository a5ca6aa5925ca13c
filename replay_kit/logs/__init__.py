"""Log formats: ``open_logs`` chooses readers by what files and folders hold, ``merge`` puts several logs in one order."""

from replay_kit.logs.formats import FORMATS, LogFormat
from replay_kit.logs.merge import Merge, merge
from replay_kit.logs.opening import open_log, open_logs

__all__ = ["FORMATS", "LogFormat", "Merge", "merge", "open_log", "open_logs"]
