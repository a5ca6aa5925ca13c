"""Trajectory planning with CasADi over a ``FlowEstimate``: ``plan`` makes a glide, ``fly`` flies it in another flow."""

from planners.settings import GlideSettings
from planners.simulate import fly
from planners.solve import plan

__all__ = ["GlideSettings", "fly", "plan"]
