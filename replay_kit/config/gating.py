"""``[gating]``: which profiles the estimator accepts, and when it inflates its own covariance."""

from typing import Literal

from pydantic import Field

from replay_kit.config.section import Section


class GatingConfig(Section):
    """``[gating]``: gate, softening and covariance inflation; the paper preset uses none of them."""

    gate: Literal["reject", "soften", "off"] = Field(
        default="reject",
        description="treatment of a profile that exceeds the gate; soften bounds how far any profile may move the estimate",
    )
    gate_probability: float = Field(
        default=1e-5,
        gt=0.0,
        lt=0.5,
        description="probability that a profile with sound errors exceeds the gate",
    )
    adapt_errors: bool = Field(
        default=True,
        description="increase a profile's errors to those that the scatter of its own bins shows",
    )
    inflate: bool = Field(
        default=True,
        description="inflate the estimate's covariance when most profiles lie outside its prediction",
    )
    inflation_profiles: int = Field(
        default=20, ge=4, description="number of latest profiles on which the inflation is decided"
    )


class ConsistencyConfig(Section):
    """``[consistency]``: the checks of sensors and labels during a replay."""

    on_failure: Literal["report", "stop", "ignore"] = Field(
        default="report",
        description="Action when sources contradict each other: report goes on without what is known to be wrong and ends with exit code "
        "6, stop ends the run with 3, ignore checks nothing.",
    )
