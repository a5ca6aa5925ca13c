"""Least energy on the way to the goals."""

from planners.mission.objectives.objective import Objective, Weights

OBJECTIVE = Objective(Weights(energy=1.0))
