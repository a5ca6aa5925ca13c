"""What a replay has read before its first message."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.grid import Ensemble
from replay_kit.core.message import LogReader
from replay_kit.workflows.replay.build import Forecasts
from replay_kit.workflows.replay.inputs import ReplayJob


@dataclass(frozen=True, slots=True, eq=False)
class Prepared:
    """What a replay has read before its first message.

    Attributes:
        job: Inputs and outputs.
        readers: The opened logs.
        forecasts: The forecast that the estimator is built from.
        prior_flow: The estimate before any observation.
        truth: What the estimate is scored against; None without.
        metadata: Records of the result: inputs, options, versions, region.
    """

    job: ReplayJob
    readers: Sequence[LogReader]
    forecasts: Forecasts
    prior_flow: FlowEstimate
    truth: Ensemble | None
    metadata: Mapping[str, Mapping[str, str]]
