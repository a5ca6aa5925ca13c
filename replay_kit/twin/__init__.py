"""Twin experiments: logs of simulated vehicles in a known current, and the synthetic ensemble that the samples come from."""

from replay_kit.twin.ensemble import synthesize, write_ensemble
from replay_kit.twin.make import TwinSummary, Vehicle, make_twin

__all__ = ["TwinSummary", "Vehicle", "make_twin", "synthesize", "write_ensemble"]
