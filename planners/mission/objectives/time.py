"""Least time on the way to the goals."""

from planners.mission.objectives.objective import Objective, Weights

OBJECTIVE = Objective(Weights(time=1.0))
