"""Observations of the current, vehicle states, and the innovations of the estimator."""

from replay_kit.core.observation.linear import (
    BOTH_COMPONENTS,
    Fix,
    Kind,
    Label,
    LinearMeasurement,
    PathMean,
    VehicleState,
)
from replay_kit.core.observation.profile import (
    STATED,
    Measurement,
    Observation,
    Reference,
    kind_of,
)
from replay_kit.core.observation.quality import (
    Decision,
    Flag,
    GroupTotals,
    Innovation,
    Reason,
    Source,
    reasons_of,
    usable,
)

__all__ = [
    "BOTH_COMPONENTS",
    "STATED",
    "Decision",
    "Fix",
    "Flag",
    "GroupTotals",
    "Innovation",
    "Kind",
    "Label",
    "LinearMeasurement",
    "Measurement",
    "Observation",
    "PathMean",
    "Reason",
    "Reference",
    "Source",
    "VehicleState",
    "kind_of",
    "reasons_of",
    "usable",
]
