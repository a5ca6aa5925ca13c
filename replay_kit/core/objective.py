"""The names of what a mission may minimise; ``planners/mission/values.py`` says what each is."""

from typing import Literal

ObjectiveName = Literal["time", "energy", "closest"]
