"""The names of what a mission may minimise; each has a file of its own in ``planners/mission/objectives``."""

from typing import Literal

ObjectiveName = Literal["time", "energy", "closest"]
