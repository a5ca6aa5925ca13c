"""Trajectory planning with CasADi over a ``FlowEstimate``."""
