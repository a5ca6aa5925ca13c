"""What the command ``plan`` is asked for, with the options that exclude each other refused."""

from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, get_args

from replay_kit.core.errors import ConfigError, PlanError
from replay_kit.core.objective import ObjectiveName
from replay_kit.core.plan import Place
from replay_kit.core.time import parse_duration, parse_time

# the planners take longer to load than what is asked for to be refused
if TYPE_CHECKING:
    from planners import Line, MissionPlan, MissionRequest, Mooring, Weights
    from planners.mission.flight.currents import Flow

# Share of the samples that may violate a constraint where none is stated.
ACCEPTED_RISK = 0.1
# Share of the samples that must arrive where none is stated.
ARRIVING = 0.9
# Samples in which a plan is judged where no number is stated.
JUDGING = 40
# Departures that are compared at most.
_MOST_DEPARTURES = 100


@dataclass(frozen=True, slots=True)
class MissionKind:
    """A mission to goals; a mooring or a line when one of these is given.

    Attributes:
        mooring: Radius [m] and duration [hours] of a mooring.
        surfacings_only: Whether only the surfacings of a mooring must lie within its radius.
        line: Whether the mission follows the line from its start to its goal.
        line_weight: Cross-track penalty of a line [h per h and km]; None for that of ``Line``.
        objective: Name of an objective, or weights; None for the configuration's.
        line_width: Largest distance of the track from a line [m]; None for that of ``Line``.
    """

    mooring: tuple[float, float] | None = None
    surfacings_only: bool = False
    line: bool = False
    line_weight: float | None = None
    objective: str | None = None
    line_width: float | None = None

    @property
    def followed(self) -> "Line | None":
        """The line; None when none is followed."""
        from planners import Line

        usual = Line()
        weight = usual.weight if self.line_weight is None else self.line_weight
        return (
            Line(weight=weight, width=usual.width if self.line_width is None else self.line_width)
            if self.line
            else None
        )

    @property
    def stay(self) -> "Mooring":
        """The mooring; there must be one."""
        from planners import Mooring

        assert self.mooring is not None, "only a mission that stays somewhere has a mooring"
        radius, hours = self.mooring
        return Mooring(radius, 3600.0 * hours, self.surfacings_only)

    def check(self, n_goals: int, risk: float | None, waypoints: bool) -> None:
        """Refuse options that do not go together.

        Args:
            n_goals: Number of goals.
            risk: Share of samples that may violate a constraint; None when none is stated.
            waypoints: Whether a list of waypoints is asked for.

        Raises:
            ConfigError: Two options exclude each other, one needs another that is not given, or the objective is none.
        """
        moored, lined = self.mooring is not None, self.line
        refusals = (
            (
                self.surfacings_only and not moored,
                "--surfacings-only: expected --mooring beside it; only a mooring counts surfacings",
            ),
            (
                self.line_weight is not None and not lined,
                "--line-weight: expected --line beside it",
            ),
            (self.line_width is not None and not lined, "--line-width: expected --line beside it"),
            (
                self.line_width is not None and not 0.0 < self.line_width < inf,
                f"--line-width: expected a number above 0, got {self.line_width}",
            ),
            (
                self.objective is not None and moored,
                "--objective: a mooring has none but to stay near its place; leave it out",
            ),
            (moored and lined, "--mooring and --line: a mission is one or the other"),
            (
                (moored or lined) and (n_goals > 1 or risk is not None),
                "--mooring and --line: expected one --goal and no --risk",
            ),
            (
                waypoints and moored,
                "--waypoints: a mooring has none on its way; give the glider the mooring's place",
            ),
        )
        for refused, message in refusals:
            if refused:
                raise ConfigError(message)
        if self.objective is not None:
            objective_of(self.objective)

    def plan(self, flow: "Flow", request: "MissionRequest") -> "MissionPlan":
        """Return the mission of this kind.

        Args:
            flow: The current, or its estimates for increasing times.
            request: Start, goals, vehicle, settings and constraints.
        """
        from planners import plan_line, plan_mission, plan_mooring

        if self.mooring is not None:
            return plan_mooring(flow, request, self.stay)
        if self.followed is not None:
            return plan_line(flow, request, self.followed)
        return plan_mission(flow, request)


@dataclass(frozen=True, slots=True)
class PlanJob:
    """A mission to plan, and the files that it is planned on.

    Attributes:
        flows: Files of the estimate; several hold for increasing times.
        start: Where it begins.
        goals: Where it goes, in this order.
        kind: To goals, a mooring, or along a line.
        no_go: GeoJSON of areas; None for none.
        bathymetry: NetCDF with the depth of the bottom; None for none.
        spline: Points per kernel length of the B-spline that the optimisation uses; 0 optimises in the estimate itself.
        risk: Share of samples that may violate a constraint; None plans without samples.
        waypoints: Whether a short list of waypoints is made.
        waypoint_tolerance: Distance off the track where no waypoint is needed [m]; None for the plan's tolerance.
        arrive: Share of the samples that must arrive for the plan to be called ``reached``.
        time_limit: Of the search [s]; None for none.
        battery: Energy that the vehicle has [MJ]; None when it is not stated.
        start_time_ns: When it begins [ns, UTC]; None for the time of the first file.
        departures_ns: Times at which it may begin, which are compared [ns, UTC]; empty for one.
        horizon: Since its start, after which no leg of the plan ends [s]; None for none.
    """

    flows: tuple[Path, ...]
    start: Place
    goals: tuple[Place, ...]
    kind: MissionKind = MissionKind()
    no_go: Path | None = None
    bathymetry: Path | None = None
    spline: int = 4
    risk: float | None = None
    waypoints: bool = False
    waypoint_tolerance: float | None = None
    arrive: float = ARRIVING
    time_limit: float | None = None
    battery: float | None = None
    start_time_ns: int | None = None
    departures_ns: tuple[int, ...] = ()
    horizon: float | None = None

    @property
    def accepted_risk(self) -> float:
        """Share of the samples that may violate a constraint."""
        return ACCEPTED_RISK if self.risk is None else self.risk

    def check(self) -> None:
        """Refuse options that do not go together.

        Raises:
            ConfigError: Two options exclude each other, or one needs another that is not given.
        """
        if self.waypoint_tolerance is not None and not self.waypoints:
            raise ConfigError("--waypoint-tolerance: expected --waypoints beside it")
        if not 0.0 <= self.arrive <= 1.0:
            raise ConfigError(f"--arrive: expected a share from 0 to 1, got {self.arrive:g}")
        for name, value in (
            ("--time-limit", self.time_limit),
            ("--battery", self.battery),
            ("--horizon", self.horizon),
        ):
            if value is not None and not 0.0 < value < inf:
                raise ConfigError(f"{name}: expected a number above 0, got {value:g}")
        self.kind.check(len(self.goals), self.risk, self.waypoints)
        self._check_times()

    def _check_times(self) -> None:
        moored_or_lined, compares = (
            self.kind.mooring is not None or self.kind.line,
            bool(self.departures_ns),
        )
        refusals = (
            (
                compares and self.start_time_ns is not None,
                "--depart and --start-time: expected one of them; leave out the other",
            ),
            (
                compares and self.risk is not None,
                "--depart and --risk: compare departures first, then plan the best with --start-time",
            ),
            (
                compares and self.horizon is not None,
                "--depart and --horizon: departures are compared by whole missions; leave out one",
            ),
            (
                moored_or_lined and (compares or self.horizon is not None),
                "--mooring and --line: expected no --depart and no --horizon",
            ),
            (
                self.horizon is not None and self.waypoints,
                "--horizon: expected no --waypoints; they lead to the goal",
            ),
        )
        for refused, message in refusals:
            if refused:
                raise ConfigError(message)

    def check_samples(self, count: int) -> None:
        """Refuse a risk that does not go with the number of samples.

        Args:
            count: Number of samples asked for.

        Raises:
            ConfigError: The risk is not a share, or comes without samples.
        """
        if self.risk is not None and not (0.0 <= self.risk < 1.0 and count > 0):
            raise ConfigError(
                f"--risk: expected a share from 0 to below 1 and --samples, got {self.risk:g} and {count}"
            )


def objective_of(text: str) -> "ObjectiveName | Weights":
    """Return an objective by its name, or weights such as ``time=1,energy=0.02,closest=5``.

    Raises:
        ConfigError: It is neither.
    """
    for name in get_args(ObjectiveName):
        if text == name:
            return name  # type: ignore[no-any-return]
    try:
        pairs = [part.partition("=") for part in text.split(",")]
        weights = {name: float(value) for name, _, value in pairs}

        from planners import Weights

        return Weights(**weights)
    except (TypeError, ValueError, PlanError) as error:
        known = ", ".join(get_args(ObjectiveName))
        raise ConfigError(
            f"--objective: expected one of {known}, or weights time=A,energy=B,closest=C, got {text!r}"
        ) from error


def departures_of(text: str) -> tuple[int, ...]:
    """Return the departures [ns, UTC] of ``--depart T0,T1,STEP``: from the first to the last, so far apart.

    Raises:
        ConfigError: These are no two times and a duration above 0, the last is before the first, or they are too many.
    """
    parts = [part.strip() for part in text.split(",")]
    if len(parts) != 3:
        raise ConfigError(
            f"--depart: expected T0,T1,STEP as in 2026-05-01T00:00Z,2026-05-03T00:00Z,12h, got '{text}'"
        )
    try:
        first, last = (parse_time(part) for part in parts[:2])
        step = parse_duration(parts[2])
    except ConfigError as error:
        raise ConfigError(f"--depart: {error}") from error
    step_ns = round(step * 1e9)
    if step_ns <= 0:
        raise ConfigError(
            f"--depart: expected a step above 0, got '{parts[2]}'; write one such as 6h"
        )
    if last < first:
        raise ConfigError(
            f"--depart: expected the first departure before the last, got '{parts[0]}' and '{parts[1]}'; swap them"
        )
    count = (last - first) // step_ns + 1
    if count > _MOST_DEPARTURES:
        raise ConfigError(
            f"--depart: expected at most {_MOST_DEPARTURES} departures, got {count}; choose a longer step"
        )
    return tuple(first + k * step_ns for k in range(count))


def horizon_of(text: str) -> float:
    """Return the seconds of ``--horizon``, such as ``72h``.

    Raises:
        ConfigError: It is no duration above 0.
    """
    try:
        seconds = parse_duration(text)
    except ConfigError as error:
        raise ConfigError(f"--horizon: {error}") from error
    if seconds <= 0.0:
        raise ConfigError(
            f"--horizon: expected a duration above 0, got '{text}'; write one such as 72h"
        )
    return seconds


def start_time_of(text: str) -> int:
    """Return the time [ns, UTC] of ``--start-time``.

    Raises:
        ConfigError: It is no time.
    """
    try:
        return parse_time(text)
    except ConfigError as error:
        raise ConfigError(f"--start-time: {error}") from error
