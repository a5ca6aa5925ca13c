"""``[time]``: how the estimate changes between observations, and what oscillates in it."""

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

Oscillation = Literal["steady", "inertial", "M2", "S2", "K1", "O1"]
Bias = Literal["heading", "scale", "shear"]


class TimeConfig(BaseModel):
    """``[time]``: the sea's change, oscillations and the instrument's biases."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    scale: Literal["auto", "static"] | Annotated[float, Field(gt=0.0)] = Field(
        default="auto",
        description="s, over which what the forecast does not say of the current is forgotten; auto: from the ensemble's change between "
        "its times, where it has several that are dated, else static; static: the current does not change",
    )
    trajectory_scale: float | None = Field(
        default=None, gt=0.0, description="s, over which a mixture of the members' own evolutions is forgotten; default five times scale"
    )
    dropped_std: float = Field(
        default=1e-3,
        ge=0.0,
        description="m/s; directions of the localised prior are dropped whose standard deviation adds up to this at most",
    )
    window: float = Field(
        default=0.0,
        ge=0.0,
        description="s; profiles that lie within it of the first of them are one update, for logs of 1 to 10 Hz; 0 takes each alone",
    )
    oscillators: tuple[Oscillation, ...] = Field(
        default=(),
        description="uniform over the region, with a depth structure of their own: inertial, M2, S2, K1, O1; steady is what does not turn "
        "and is finer in depth than the forecast's levels",
    )
    oscillator_std: float = Field(default=0.1, gt=0.0, description="m/s; prior standard deviation of an oscillation's components")
    oscillator_scale: float = Field(default=259200.0, gt=0.0, description="s, over which an oscillation's phase is forgotten")
    oscillator_depth_length: float = Field(default=100.0, gt=0.0, description="m, over which oscillations stay alike in depth")
    biases: tuple[Bias, ...] = Field(default=(), description="errors of the instrument that are estimated: heading, scale, shear")
    heading_bias_std: float = Field(default=5.0, gt=0.0, description="degrees, prior")
    scale_bias_std: float = Field(default=0.05, gt=0.0, description="share of the velocity relative to the platform, prior")
    shear_bias_std: float = Field(default=2e-4, gt=0.0, description="m/s a metre from the instrument, along the way through water, prior")
