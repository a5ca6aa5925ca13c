"""Least miss distance; of two equally close missions the quicker one."""

from planners.mission.objectives.objective import Objective, Weights

OBJECTIVE = Objective(Weights(time=1.0), distance_first=True)
