"""``[planner]``: what a replay plans, and when."""

from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import Annotated, Literal, Self, get_args

from pydantic import AfterValidator, Field, model_validator

from replay_kit.config.option import Option
from replay_kit.config.section import Section
from replay_kit.core.as_flown import AsFlown
from replay_kit.core.objective import ObjectiveName, is_objective, objective_names

# Of a vehicle that is not known to have dived: m/s, m; and glide angles in degrees.
_SPEED, _DEPTH = 0.3, 500.0
_MIN_ANGLE, _MAX_ANGLE = 15.0, 35.0


def _known_objective(name: str) -> str:
    if not is_objective(name):
        raise ValueError(f"expected one of {', '.join(objective_names())}, got '{name}'")
    return name


@dataclass(frozen=True, slots=True)
class DiveSettings:
    """How a vehicle that is planned for dives.

    Attributes:
        speed: Through water [m/s].
        depth: Of a mission's dives [m].
        min_angle: Shallowest glide [degrees].
        max_angle: Steepest glide [degrees].
        origin: Which of these no setting states, and whether they are as flown or assumed, in words; empty where all are stated.
    """

    speed: float
    depth: float
    min_angle: float
    max_angle: float
    origin: str


class PlannerConfig(Section):
    """``[planner]``: one glide, or a mission of many dives; keys that only a mission has say so."""

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
    speed: float | None = Field(
        default=None,
        gt=0.0,
        description="Speed through water [m/s]. Default: as flown, the median of the log's dives, else 0.3.",
    )
    tolerance: float = Field(
        default=250.0, gt=0.0, description="Distance from the goal within which it is reached [m]."
    )
    interval: float = Field(
        default=43200.0,
        gt=0.0,
        description="Log time between plans [s]; a very large number plans at the end only.",
    )
    max_duration: float = Field(
        default=432000.0,
        gt=0.0,
        description="Longest glide or mission considered [s] (plan: 1200000).",
    )
    depth: float | None = Field(
        default=None,
        gt=0.0,
        description="Depth of a mission's dives [m]. Default: as flown, the median of the log's dives, else 500.",
    )
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
    max_legs: int | None = Field(
        default=None,
        ge=1,
        description="Largest number of surfacings of a mission considered. Default: as many as max_duration takes, of a mooring 60.",
    )
    objective: Annotated[str, AfterValidator(_known_objective)] = Field(
        default="time",
        description=f"What a mission minimises: {', '.join(get_args(ObjectiveName))}, or an installed package's own.",
    )
    min_angle: float | None = Field(
        default=None,
        gt=0.0,
        lt=90.0,
        description="Shallowest glide angle of a mission [degrees]. Default: as flown where the speed is, else 15.",
    )
    max_angle: float | None = Field(
        default=None,
        gt=0.0,
        lt=90.0,
        description="Steepest glide angle of a mission [degrees]. Default: 35, or as flown where that is more.",
    )
    margin: float = Field(
        default=50.0,
        ge=0.0,
        description="Minimum distance of a mission from land, shallows and no-go areas [m].",
    )
    bathymetry: Annotated[str | None, Option("--bathymetry", "FILE.nc")] = Field(
        default=None,
        description="Bottom depth on a grid (NetCDF); dives turn, and a glide ends, above it.",
    )
    clearance: Annotated[float, Option("--clearance")] = Field(
        default=20.0, ge=0.0, description="Minimum height of a plan above the bottom [m]."
    )
    flow_step: float = Field(
        default=43200.0,
        gt=0.0,
        description="Time between the estimates that a mission is planned on where the current changes [s].",
    )
    samples: int | None = Field(
        default=None,
        ge=0,
        description="Number of samples of the estimate in which a mission is simulated, for its odds and surfacing ellipses. "
        "Default: 40 for plan and for the last plan of a replay, 0 for the plans before it.",
    )
    seed: int = Field(default=0, ge=0, description="Seed of the samples.")

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        least, most = self.min_angle or _MIN_ANGLE, self.max_angle or _MAX_ANGLE
        if least > most:
            raise ValueError(f"min_angle {least:g} is above max_angle {most:g}; give them in order")
        if self.samples in (1, 2):
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

    def diving(
        self, flown: AsFlown | None = None, goal_depth: float = 0.0, deepest: float = inf
    ) -> DiveSettings:
        """Return how the vehicle dives, with what no setting states as the log's dives were flown, or else assumed.

        A depth that is not stated reaches the goal, and passes neither the forecast nor the vehicle's limit. Speed and glide angle belong
        together: beside a speed that is stated the angles are the usual ones.

        Args:
            flown: The median of the log's dives; None where they are not known.
            goal_depth: [m].
            deepest: Level of the forecast [m].
        """
        angle = _MIN_ANGLE if flown is None or self.speed is not None else flown.glide_angle_deg
        most = self.max_angle or max(_MAX_ANGLE, angle)
        usual = max(_DEPTH if flown is None else flown.depth, goal_depth)
        speed = self.speed or (_SPEED if flown is None else flown.speed)
        depth = self.depth or min(usual, deepest, self.depth_limit)
        least = self.min_angle or min(angle, most)
        return DiveSettings(speed, depth, least, most, self._origin(flown, speed, depth, least))

    def _origin(self, flown: AsFlown | None, speed: float, depth: float, angle: float) -> str:
        """Return what of some dives no setting states."""
        parts = [] if self.speed else [f"{speed:.2f} m/s"]
        if self.depth is None and self.kind != "glide":
            went = (
                ""
                if flown is None or depth == flown.depth
                else f" (dives went to {flown.depth:.0f} m)"
            )
            parts.append(f"{depth:.0f} m{went}")
        if flown is not None and not (self.speed or self.min_angle) and self.kind != "glide":
            parts.append(f"{angle:.0f} degrees")
        return f"{'assumed' if flown is None else 'as flown'}: {', '.join(parts)}" if parts else ""

    def resolved(self, of_glider: bool) -> Self:
        """Return the settings with a kind for ``auto``: a mission for a glider's log, a glide for others."""
        return (
            self
            if self.kind != "auto"
            else self.model_copy(update={"kind": "mission" if of_glider else "glide"})
        )
