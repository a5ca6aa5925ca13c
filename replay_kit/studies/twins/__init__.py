"""Twin experiments: logs of simulated vehicles in a known current, and the synthetic ensemble that the samples come from."""

from replay_kit.studies.twins.adcp import Faults
from replay_kit.studies.twins.ensemble import synthesize, write_ensemble
from replay_kit.studies.twins.make import Twin, TwinSummary, Vehicle, make_twin
from replay_kit.studies.twins.vehicle import EPOCH

__all__ = [
    "EPOCH",
    "Faults",
    "Twin",
    "TwinSummary",
    "Vehicle",
    "make_twin",
    "synthesize",
    "write_ensemble",
]
