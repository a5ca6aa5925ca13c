"""``[planner]``: what a replay plans, and when."""

from typing import Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator


class PlannerConfig(BaseModel):
    """``[planner]``: one glide, or a mission of many dives; keys that only a mission has say so."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    kind: Literal["glide", "mission"] = Field(default="glide", description="one constant velocity through water, or a mission of dives")
    when: Literal["interval", "surfacing"] | None = Field(
        default=None,
        description="surfacing: planned anew there, and after an interval without one; default: interval for a glide, else surfacing",
    )
    speed: float = Field(default=0.3, gt=0.0, description="m/s through water")
    tolerance: float = Field(default=250.0, gt=0.0, description="m; a plan that passes this close has reached the goal")
    interval: float = Field(default=43200.0, gt=0.0, description="s of log time between plans; a very large number plans only at the end")
    max_duration: float = Field(default=432000.0, gt=0.0, description="s; longest glide or mission considered")
    depth: float = Field(default=500.0, gt=0.0, description="m, of a mission's dives")
    dives: int = Field(default=1, ge=1, description="of a mission, between surfacings; heading and glide angle are held")
    surface_time: float = Field(default=0.0, ge=0.0, description="s adrift at each surfacing of a mission")
    legs: int | None = Field(default=None, ge=1, description="surfacings of a mission, from its first plan on; default as many as is best")
    max_legs: int = Field(default=60, ge=1, description="most surfacings of a mission considered")
    objective: Literal["time", "energy", "closest"] = Field(default="time", description="what a mission makes least")
    min_angle: float = Field(default=15.0, gt=0.0, lt=90.0, description="degrees, a mission's shallowest glide")
    max_angle: float = Field(default=35.0, gt=0.0, lt=90.0, description="degrees, its steepest")
    margin: float = Field(default=50.0, ge=0.0, description="m that a mission keeps from where it may not go")
    flight_model: bool = Field(default=False, description="a mission's speed from glide angle and buoyancy, not constant")
    flow_step: float = Field(
        default=43200.0, gt=0.0, description="s between the estimates that a mission is planned on, where the current changes"
    )
    samples: int = Field(default=0, ge=0, description="of the estimate, for the ellipse of a mission's next surfacing; 0 for none")
    seed: int = Field(default=0, ge=0, description="of the samples")

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.min_angle > self.max_angle:
            raise ValueError(f"min_angle {self.min_angle:g} is above max_angle {self.max_angle:g}; give them in order")
        if 0 < self.samples < 3:
            raise ValueError(f"samples: an ellipse needs three or more, got {self.samples}")
        return self

    @property
    def at_surfacings(self) -> bool:
        """Whether a replay plans anew at each surfacing."""
        return (self.when or ("surfacing" if self.kind == "mission" else "interval")) == "surfacing"
