"""``[planner]``: what a replay plans, and when."""

from math import inf
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from replay_kit.config.option import Option
from replay_kit.core.objective import ObjectiveName


class PlannerConfig(BaseModel):
    """``[planner]``: one glide, or a mission of many dives; keys that only a mission has say so."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, defer_build=True)

    kind: Annotated[Literal["auto", "glide", "mission"], Option("--planner")] = Field(
        default="auto",
        description="What is planned: a glide, one constant velocity through water, or a mission of dives; auto: for a glider's log a "
        "mission, for others a glide.",
    )
    when: Literal["interval", "surfacing"] = Field(
        default="interval",
        description="When a plan is made: at intervals, a mission at the first surfacing after each; or at each surfacing, and after an "
        "interval without one.",
    )
    speed: float = Field(default=0.3, gt=0.0, description="Speed through water [m/s].")
    tolerance: float = Field(
        default=250.0, gt=0.0, description="Distance from the goal within which it is reached [m]."
    )
    interval: float = Field(
        default=43200.0,
        gt=0.0,
        description="Log time between plans [s]; a very large number plans at the end only.",
    )
    max_duration: float = Field(
        default=432000.0, gt=0.0, description="Longest glide or mission considered [s]."
    )
    depth: float = Field(default=500.0, gt=0.0, description="Depth of a mission's dives [m].")
    max_depth: float | None = Field(
        default=None,
        gt=0.0,
        description="Greatest depth of the vehicle [m]; deeper dives and goals are refused. Default: none.",
    )
    dives: int = Field(
        default=1,
        ge=1,
        description="Number of a mission's dives between surfacings; heading and glide angle are held.",
    )
    surface_time: float = Field(
        default=0.0, ge=0.0, description="Time that a mission drifts at each surfacing [s]."
    )
    legs: int | None = Field(
        default=None,
        ge=1,
        description="Number of surfacings of a mission, from its first plan on. Default: the best number.",
    )
    max_legs: int = Field(
        default=60, ge=1, description="Largest number of surfacings of a mission considered."
    )
    objective: ObjectiveName = Field(default="time", description="What a mission minimises.")
    min_angle: float = Field(
        default=15.0, gt=0.0, lt=90.0, description="Shallowest glide angle of a mission [degrees]."
    )
    max_angle: float = Field(
        default=35.0, gt=0.0, lt=90.0, description="Steepest glide angle of a mission [degrees]."
    )
    margin: float = Field(
        default=50.0,
        ge=0.0,
        description="Distance that a mission keeps from land, shallows and no-go areas [m].",
    )
    bathymetry: Annotated[str | None, Option("--bathymetry", "FILE.nc")] = Field(
        default=None,
        description="Depth of the bottom on a grid, above which a mission's dives turn and a glide ends; NetCDF.",
    )
    clearance: Annotated[float, Option("--clearance")] = Field(
        default=20.0, ge=0.0, description="Least height of a plan above the bottom [m]."
    )
    flow_step: float = Field(
        default=43200.0,
        gt=0.0,
        description="Time between the estimates that a mission is planned on where the current changes [s].",
    )
    samples: int = Field(
        default=0,
        ge=0,
        description="Number of samples of the estimate that a mission is flown through (plan: 40), for its odds and the ellipses of its "
        "surfacings.",
    )
    seed: int = Field(default=0, ge=0, description="Seed of the samples.")

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.min_angle > self.max_angle:
            raise ValueError(
                f"min_angle {self.min_angle:g} is above max_angle {self.max_angle:g}; give them in order"
            )
        if 0 < self.samples < 3:
            raise ValueError(f"samples: an ellipse needs three or more, got {self.samples}")
        return self

    @property
    def depth_limit(self) -> float:
        """Greatest depth of the vehicle [m]; infinite where none is stated."""
        return inf if self.max_depth is None else self.max_depth

    @property
    def bathymetry_path(self) -> Path | None:
        """File of the bathymetry; None without."""
        return None if self.bathymetry is None else Path(self.bathymetry)

    def resolved(self, of_glider: bool, goal_depth: float, deepest: float) -> Self:
        """Return the settings with a kind for ``auto``, and for a mission with a depth of its dives where none is stated.

        Args:
            of_glider: Whether the log is a glider's.
            goal_depth: [m]; the dives reach it.
            deepest: Level of the forecast [m]; the dives do not pass it.
        """
        if self.kind != "auto":
            return self
        if not of_glider:
            return self.model_copy(update={"kind": "glide"})
        depth = (
            self.depth
            if "depth" in self.model_fields_set
            else min(max(self.depth, goal_depth), deepest, self.depth_limit)
        )
        return self.model_copy(update={"kind": "mission", "depth": depth})
