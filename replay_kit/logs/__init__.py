"""Log formats: ``open_logs`` selects readers by the contents of files and folders, ``merge`` orders several logs in time."""

from replay_kit.logs.merge import Merge, merge
from replay_kit.logs.opening import FORMATS, LogFormat, open_log, open_logs

__all__ = ["FORMATS", "LogFormat", "Merge", "merge", "open_log", "open_logs"]
