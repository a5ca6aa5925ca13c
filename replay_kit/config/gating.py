"""``[trust]``: which pings the estimator believes, and when it stops believing itself."""

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field


class TrustConfig(BaseModel):
    """``[trust]``: gate, softening and the watch over the estimate's own errors; the paper preset uses none of it."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, defer_build=True)

    gate: Literal["reject", "soften", "off"] = Field(
        default="reject",
        description="what becomes of a profile beyond the gate; soften lets every profile move the estimate by a bounded amount",
    )
    gate_probability: float = Field(default=1e-5, gt=0.0, lt=0.5, description="of a sound profile beyond the gate")
    soften_factor: float = Field(default=2.0, gt=0.0, description="K: about how many prior standard deviations a softened profile may move")
    adapt_errors: bool = Field(default=True, description="grow a profile's errors to those that its own bins show")
    watch: bool = Field(default=True, description="grow the estimate's uncertainty when most profiles lie outside what it expects")
    watch_profiles: int = Field(default=20, ge=4, description="number of latest profiles that the watch looks at")
