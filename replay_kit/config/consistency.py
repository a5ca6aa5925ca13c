"""``[consistency]``: what follows when a log contradicts itself."""

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field


class ConsistencyConfig(BaseModel):
    """``[consistency]``: the checks of sensors and labels during a replay."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, defer_build=True)

    on_failure: Literal["report", "stop", "ignore"] = Field(
        default="report",
        description="Action when sources contradict each other: report goes on without what is known to be wrong and ends with exit code "
        "6, stop ends the run with 3, ignore checks nothing.",
    )
