"""``[planner]``: kind, times and vehicle of plans."""

from dataclasses import dataclass, replace
from math import inf, sqrt
from pathlib import Path
from typing import Annotated, Literal, Self, get_args

from pydantic import AfterValidator, Field, field_validator, model_validator

from replay_kit.config.file import Count, NotNegative, Positive, Section
from replay_kit.config.option import Option
from replay_kit.core.as_flown import AsFlown
from replay_kit.core.extensions import ObjectiveName, objective_names

# Of a vehicle that is not known to have dived: m/s, m; and glide angles in degrees.
_SPEED, _DEPTH = 0.3, 500.0
_MIN_ANGLE, _MAX_ANGLE = 15.0, 35.0
# m/s, of any vehicle that is planned for
_FASTEST = 5.0


def _known_objective(name: str) -> str:
    if name not in objective_names():
        raise ValueError(f"expected one of {', '.join(objective_names())}, got '{name}'")
    return name


@dataclass(frozen=True, slots=True)
class DiveSettings:
    """Dive settings of the vehicle.

    Attributes:
        speed: Speed through water [m/s].
        depth: Depth of dives [m].
        yos: Yos between surfacings.
        min_angle, max_angle: Shallowest and steepest glide angle [degrees].
        depths, speeds: Ranges, if stated [m], [m/s].
        surface_time: Duration of drift at each surfacing [s].
        radius: Radius of a goal [m]; None for the tolerance.
        speed_spread: Relative spread of the speed; 0 if unknown.
        speed_error: Relative standard error of the speed.
        origin: Values that no setting states, as text.
    """

    speed: float
    depth: float
    yos: int
    min_angle: float
    max_angle: float
    depths: tuple[float, float] | None
    speeds: tuple[float, float] | None
    surface_time: float
    radius: float | None
    speed_spread: float
    speed_error: float
    origin: str


def _ends(text: str) -> tuple[float, float]:
    """Return the ends of a range such as 100:700."""
    least, _, most = text.partition(":")
    return float(least), float(most)


class PlannerConfig(Section):
    """``[planner]``: one glide, or a mission of many dives; keys that only a mission has say so.

    Attributes:
        kind: Kind of plan: a glide, one constant velocity, or a mission of dives; auto: a mission for a glider's log, and
            from the first dive at a glider's speed on; a glide for others.
        when: Times of plans: at intervals, for a mission at the next surfacing; or at each surfacing.
        speed: Speed through water [m/s]; of a vehicle with --thrust a range too, as 0.5:1.5, in which it is chosen. Default: as flown,
            else 0.3.
        tolerance: Distance from the goal within which it is reached [m].
        radius: Distance from a goal at which a simulated flight arrives [m]. Default: as flown, else the tolerance.
        interval: Log time between plans [s]; a very large number plans at the end only.
        max_duration: Longest glide or mission considered [s] (plan: 1200000).
        depth: Depth of a mission's dives [m], or a range such as 100:700, chosen for each leg. Default: as flown, else 500.
        max_depth: Greatest depth of the vehicle [m]; deeper dives and goals are refused. Default: none.
        dives: Number of a mission's dives between surfacings; heading and glide angle are held. Default: as flown, else 1.
        surface_time: Duration of drift at each surfacing of a mission [s]. Default: as flown, else 0.
        legs: Number of surfacings of a mission, from its first plan on. Default: the best number.
        max_legs: Most surfacings of a mission. Default: as many as max_duration takes, of a mooring 60.
        min_angle: Shallowest glide angle of a mission [degrees]. Default: as flown with the speed, else 15.
        max_angle: Steepest glide angle of a mission [degrees]. Default: 35, or as flown where that is more.
        hotel: Power of all but pump and propeller [W].
        thrust: Power of a propeller at 1 m/s [W]; above 0 the vehicle has no pump.
        margin: Minimum distance of a mission from land, shallows and no-go areas [m].
        bathymetry: Bottom depth on a grid (NetCDF); dives turn, and a glide ends, above it.
        clearance: Minimum height of a plan above the bottom [m].
        flow_step: Interval of the estimates for a mission in a changing current [s].
        samples: Number of simulated flights of a mission, for its odds and ellipses. Default: 100 for plan and the
            last plan of a replay, else 0.
        seed: Seed of the samples.
    """

    kind: Annotated[Literal["auto", "glide", "mission"], Option(name="--planner")] = "auto"
    when: Literal["interval", "surfacing"] = "interval"
    speed: Annotated[float | str | None, Option("M/S|MIN:MAX")] = None
    tolerance: Positive = 250.0
    radius: Annotated[Positive | None, Option("METRES")] = None
    interval: Positive = 43200.0
    max_duration: Annotated[Positive, Option()] = 432000.0
    depth: Annotated[float | str | None, Option("METRES|MIN:MAX")] = None
    max_depth: Annotated[Positive | None, Option("METRES")] = None
    dives: Count | None = None
    surface_time: Annotated[NotNegative | None, Option("SECONDS")] = None
    legs: Count | None = None
    max_legs: Annotated[Count | None, Option("COUNT")] = None
    objective: Annotated[str, AfterValidator(_known_objective)] = Field(
        default="time",
        description=f"What a mission minimises: {', '.join(get_args(ObjectiveName))}, or an installed package's own.",
    )
    min_angle: Annotated[float, Field(gt=0.0, lt=90.0)] | None = None
    max_angle: Annotated[float, Field(gt=0.0, lt=90.0)] | None = None
    hotel: Annotated[Positive, Option()] = 1.0
    thrust: Annotated[NotNegative, Option()] = 0.0
    margin: Annotated[NotNegative, Option()] = 50.0
    bathymetry: Annotated[str | None, Option("FILE.nc")] = None
    clearance: Annotated[NotNegative, Option()] = 20.0
    flow_step: Positive = 43200.0
    samples: Annotated[Annotated[int, Field(ge=0)] | None, Option("COUNT")] = None
    seed: Annotated[int, Field(ge=0)] = 0

    @field_validator("speed", "depth", mode="before")
    @classmethod
    def _number_or_range(cls, value: object) -> object:
        if value is None:
            return None
        if not isinstance(value, str) or ":" not in value:
            value = float(value)  # type: ignore[arg-type]
            least = most = value
        else:
            least, most = _ends(value)
        if not 0.0 < least <= most < inf:
            raise ValueError("expected a number above 0, or a range as 100:700")
        return value

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        least, most = self.min_angle or _MIN_ANGLE, self.max_angle or _MAX_ANGLE
        if least > most:
            raise ValueError(f"min_angle {least:g} is above max_angle {most:g}; give them in order")
        fastest = _ends(self.speed)[1] if isinstance(self.speed, str) else self.speed or 0.0
        if fastest > _FASTEST:
            raise ValueError(f"speed: expected up to {_FASTEST:g} m/s, got {fastest:g}; in cm/s?")
        if isinstance(self.speed, str) and not self.thrust:
            raise ValueError(
                "a range of speeds needs thrust: a glider's speed follows from its glide"
            )
        if self.samples in (1, 2):
            raise ValueError(f"samples: an ellipse needs three or more, got {self.samples}")
        return self

    @property
    def depth_limit(self) -> float:
        """Greatest depth of the vehicle [m]; infinite without a limit."""
        return inf if self.max_depth is None else self.max_depth

    @property
    def bathymetry_path(self) -> Path | None:
        """Bathymetry file; None without one."""
        return None if self.bathymetry is None else Path(self.bathymetry)

    def diving(
        self, flown: AsFlown | None = None, goal_depth: float = 0.0, deepest: float = inf
    ) -> DiveSettings:
        """Return the dive settings: values that no setting states are as flown, or else assumed.

        An unstated depth reaches the goal; an assumed one stays above the forecast's deepest level. With a stated speed the angles are the
        usual ones.

        Args:
            flown: Median of the log's dives; None if unknown.
            goal_depth: Depth of the goal [m].
            deepest: Deepest level of the forecast [m].
        """
        # a speed that no glider has says nothing of its glide either, while a depth is measured
        gliding = flown if self.speed is None and flown is not None and flown.is_plausible else None
        angle = _MIN_ANGLE if gliding is None else gliding.glide_angle_deg
        most = self.max_angle or max(_MAX_ANGLE, angle)
        usual = max(_DEPTH if flown is None else flown.depth, goal_depth)
        (speeds, speed), (depths, stated) = (
            ((_ends(value), _ends(value)[1]) if isinstance(value, str) else (None, value))
            for value in (self.speed, self.depth)
        )
        depth = stated or min(usual, deepest * (1.0 if flown is None else 2.0), self.depth_limit)
        if depths is not None:
            depth = min(depth, deepest, self.depth_limit)
        spread = 0.0 if gliding is None else (gliding.speed_std or 0.0) / gliding.speed
        drift, radius = (
            (None, None)
            if flown is None or self.kind == "glide"
            else (flown.surface_time, flown.radius)
        )
        dives = DiveSettings(
            speed=speed or (_SPEED if gliding is None else gliding.speed),
            depth=depth,
            yos=self.dives or (1 if flown is None else flown.yos),
            min_angle=self.min_angle or min(angle, most),
            max_angle=most,
            depths=depths,
            speeds=speeds,
            surface_time=(drift or 0.0) if self.surface_time is None else self.surface_time,
            radius=self.radius or radius,
            speed_spread=spread,
            speed_error=spread / sqrt(1 if gliding is None else gliding.dives),
            origin="",
        )
        return replace(dives, origin=self._origin(flown, dives))

    def _origin(self, flown: AsFlown | None, dives: DiveSettings) -> str:
        """Return the dive settings that no setting states, as text."""
        asked = [] if self.speed else [f"{dives.speed:.2f} m/s"]
        shape = list[str]()
        if self.kind != "glide" and self.depth is None:
            other = (
                ""
                if flown is None or dives.depth == flown.depth
                else f" (flown to {flown.depth:.0f} m)"
            )
            shape.append(f"dives to {dives.depth:.0f} m{other}")
        if self.dives is None and dives.yos > 1:
            shape.append(f"{dives.yos} between surfacings")
        if self.radius is None and dives.radius:
            shape.append(f"goals within {dives.radius:.0f} m")
        if flown is None:
            return f"assumed: {', '.join(asked + shape)}" if asked + shape else ""
        by = "as flown" if flown.dives > 1 else "as flown in a single dive"
        if asked and not flown.is_plausible:
            wrong = f"assumed: {asked[0]}, as the log's dives show {flown.speed:.2f} m/s, which no glider flies (set --speed)"
            return "; ".join([wrong, *(f"{by}: {part}" for part in shape)])
        if self.kind != "glide" and asked:
            if shape and dives.depth == flown.depth:
                shape.append(f"{flown.duration / 3600.0:.1f} h")
            if not self.min_angle:
                # the shallowest is as flown, and a plan may choose steeper ones
                angles = dict.fromkeys(f"{a:.0f}" for a in (dives.min_angle, dives.max_angle))
                shape.append(f"{' to '.join(angles)} degrees")
        return f"{by}: {', '.join(asked + shape)}" if asked + shape else ""

    def resolved(self, of_glider: bool) -> Self:
        """Return the settings with ``auto`` resolved: a mission for a glider, a glide for others."""
        return (
            self
            if self.kind != "auto"
            else self.model_copy(update={"kind": "mission" if of_glider else "glide"})
        )
