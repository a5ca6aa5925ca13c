"""``[plan]``: the request of ``plan``; the file, the options and the record of a result have the same names and values.

Places, times and lists of numbers are texts, as on the command line, and are parsed on access.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, get_args

from pydantic import ConfigDict, Field

from replay_kit.config.file import NotNegative, Section
from replay_kit.config.option import PLACE, PLACES, Numbers, Option, numbers
from replay_kit.core.errors import ConfigError
from replay_kit.core.extensions import ObjectiveName
from replay_kit.core.words.quantities import parse_duration, parse_time
from replay_kit.core.words.text import time_text

# loads numpy
if TYPE_CHECKING:
    from replay_kit.core.plan import Place

#: Share of the samples that may violate a constraint where none is stated.
ACCEPTED_RISK = 0.1
#: Share of the samples that must arrive where none is stated.
ARRIVING = 0.9
# Departures that are compared at most.
_MOST_DEPARTURES = 100
# What the name of a glider may hold: it becomes part of file names.
_NAME = frozenset("abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789-_")
_INPUTS, _OPTIONS, _OUTPUTS = "Inputs", "Options", "Outputs"


class PlanRequest(Section):
    """``[plan]``: start, goals, times, objective and limits of a mission.

    Attributes:
        flows: Files of the estimate.
        start: Where the mission begins [degrees, degrees, m]. Default: the last fix of a result.
        goal: Goal [degrees, degrees, m]; may be repeated, in order. Default: that of a result. NAME= fixes it to one glider.
        glider: Start of one of several gliders, instead of --start; once for each. They share the goals, and each has its own files.
        no_go: No-go polygons (GeoJSON, KML). By their properties: surface_only may be passed below; fence must not be left; begin and
            end limit the time in which one holds.
        bathymetry: Depth of the bottom on a grid.
        start_time: Start time of the mission, ISO 8601 UTC. Default: the time of a result's last fix; of an estimate alone its time.
        depart: Compare departures from T0 to T1; the best by --objective is planned, by default the earliest arrival.
        horizon: Plan only this far ahead, such as 72h, and report what remains.
        mooring: Stay within a radius of the goal [m] for a duration [hours].
        surfacings_only: With --mooring: only surfacings, not the track between them, must lie within the radius.
        line: Follow the line from the start to the goal.
        line_width: Largest distance of the track from the line at which the goal counts as reached [m]. Default: 2000.
        risk: Plan with a margin such that at most this fraction of samples violates a constraint.
        arrive: Fraction of samples that must arrive for the status reached.
        held: Also state how many arrive with the planned headings held.
        arrive_by: Latest arrival that counts: ISO 8601 UTC, or a duration such as 36h.
        time_limit: Stop searching for other legs, routes and margins after this time [s].
        separation: With --glider: least horizontal distance between two gliders at the same time [m].
        battery: Energy available [MJ].
        of_glider: Glider whose plan a result holds, of several.
        waypoints: Whether a short list of waypoints is made.
        waypoint_tolerance: Distance off the track within which no waypoint is needed [m]. Default: the tolerance of the plan.
    """

    # numbers that are not finite are refused by name below
    model_config = ConfigDict(allow_inf_nan=True)

    flows: tuple[Path, ...] = ()
    start: Annotated[str | None, Option(PLACE.form, _INPUTS), PLACE] = None
    goal: Annotated[tuple[str, ...], Option(PLACE.form, _INPUTS, True), PLACES] = ()
    glider: Annotated[tuple[str, ...], Option(f"NAME={PLACE.form}", _INPUTS, True), PLACES] = ()
    no_go: Annotated[Path | None, Option("FILE", _INPUTS)] = None
    bathymetry: Annotated[Path | None, Option("FILE.nc", _INPUTS)] = None
    start_time: Annotated[str | None, Option("TIME", _OPTIONS)] = None
    depart: Annotated[str | None, Option("T0,T1,STEP", _OPTIONS)] = None
    horizon: Annotated[str | None, Option("DURATION", _OPTIONS)] = None
    objective: Annotated[str | None, Option("NAME|WEIGHTS", _OPTIONS)] = Field(
        default=None,
        description=f"{', '.join(get_args(ObjectiveName))} or weights of hours, kJ and km from the goal, as time=1,energy=0.02,closest=5: "
        "the cost. Default: time.",
    )
    mooring: Annotated[str | None, Option("RADIUS,HOURS", _OPTIONS), Numbers("RADIUS,HOURS")] = None
    surfacings_only: Annotated[bool, Option(None, _OPTIONS)] = False
    line: Annotated[bool, Option(None, _OPTIONS)] = False
    line_width: Annotated[float | None, Option(None, _OPTIONS)] = None
    risk: Annotated[float | None, Option("SHARE", _OPTIONS)] = None
    arrive: Annotated[float, Option("SHARE", _OPTIONS)] = ARRIVING
    held: Annotated[bool, Option(None, _OPTIONS)] = False
    arrive_by: Annotated[str | None, Option("WHEN", _OPTIONS)] = None
    time_limit: Annotated[float | None, Option("SECONDS", _OPTIONS)] = None
    separation: Annotated[float | None, Option("METRES", _OPTIONS)] = None
    battery: Annotated[float | None, Option("MJ", _OPTIONS)] = None
    of_glider: str | None = None
    waypoints: bool = False
    waypoint_tolerance: Annotated[NotNegative | None, Option(None, _OUTPUTS)] = None

    @property
    def accepted_risk(self) -> float:
        """Fraction of the samples that may violate a constraint."""
        return ACCEPTED_RISK if self.risk is None else self.risk

    @property
    def start_place(self) -> "Place":
        """Start of the mission."""
        if self.start is None:
            raise ConfigError(
                "--start is missing; expected replay-kit plan FLOW... --start LON,LAT,DEPTH --goal LON,LAT,DEPTH, or a result with a fix."
            )
        return _place(self.start, "--start")

    @property
    def goals(self) -> tuple["Place", ...]:
        """Goals, in order."""
        return tuple(_place(text, "--goal") for text in self.goal)

    @property
    def glider_places(self) -> dict[str, "Place"]:
        """Start of each of several gliders, by name."""
        found: dict[str, Place] = {}
        for text in self.glider:
            name, equals, place = text.rpartition("=")
            if not equals or not name or name in found or not set(name) <= _NAME:
                raise ConfigError(
                    f"--glider: expected NAME={PLACE.form} with another name for each, of letters, digits, '-' and '_', got '{text}'"
                )
            found[name] = _place(place, "--glider")
        return found

    @property
    def goals_of_gliders(self) -> tuple[tuple[str, "Place"], ...]:
        """Glider assigned to each goal and the goal; the name is empty for all gliders."""
        named = [text.rpartition("=")[::2] for text in self.goal]
        return tuple((name, _place(place, "--goal")) for name, place in named)

    @property
    def mooring_numbers(self) -> tuple[float, float] | None:
        """Radius [m] and duration [h] of a mooring; None for another mission."""
        if self.mooring is None:
            return None
        radius, hours = numbers(self.mooring, "--mooring", "RADIUS,HOURS")
        if min(radius, hours) <= 0.0:
            raise ConfigError(f"--mooring: expected numbers above 0, got {self.mooring}")
        return radius, hours

    @property
    def start_time_ns(self) -> int | None:
        """Start time [ns, UTC]; None for the time of the estimate."""
        return None if self.start_time is None else _time(self.start_time, "--start-time")

    @property
    def departures_ns(self) -> tuple[int, ...]:
        """Departure times to compare [ns, UTC]; empty for a single one."""
        return () if self.depart is None else departures_of(self.depart)

    @property
    def horizon_s(self) -> float | None:
        """Time since the start after which no leg ends [s]; None without a horizon."""
        return None if self.horizon is None else _duration(self.horizon, "--horizon")

    def arrive_by_s(self, begin_ns: int) -> float | None:
        """Return the latest arrival as a time since a start [ns, UTC] [s]; None without a limit.

        Raises:
            ConfigError: It is neither a time nor a duration, or not after the start.
        """
        if self.arrive_by is None:
            return None
        # a duration ends in its unit
        if self.arrive_by.strip()[-1:] in "sinhd":
            return _duration(self.arrive_by, "--arrive-by")
        seconds = (_time(self.arrive_by, "--arrive-by") - begin_ns) / 1e9
        if seconds <= 0.0:
            raise ConfigError(
                f"--arrive-by: expected a time after the start at {time_text(begin_ns)}, got {self.arrive_by}; give a later one, or an "
                "earlier --start-time"
            )
        return seconds


def departures_of(text: str) -> tuple[int, ...]:
    """Return the departure times [ns, UTC] of ``--depart T0,T1,STEP``.

    Raises:
        ConfigError: The text is not two times and a duration above 0, T1 precedes T0, or the times are too many.
    """
    parts = [part.strip() for part in text.split(",")]
    if len(parts) != 3:
        raise ConfigError(
            f"--depart: expected T0,T1,STEP as in 2026-05-01T00:00Z,2026-05-03T00:00Z,12h, got '{text}'"
        )
    first, last = (_time(part, "--depart") for part in parts[:2])
    step_ns = round(1e9 * _duration(parts[2], "--depart")) or 1
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


def _duration(text: str, name: str) -> float:
    try:
        seconds = parse_duration(text)
    except ConfigError as error:
        raise ConfigError(f"{name}: {error}") from error
    if seconds <= 0.0:
        raise ConfigError(
            f"{name}: expected a duration above 0, got '{text}'; write one such as 72h"
        )
    return seconds


def _time(text: str, name: str) -> int:
    try:
        return parse_time(text)
    except ConfigError as error:
        raise ConfigError(f"{name}: {error}") from error


def _place(text: str, name: str) -> "Place":
    from replay_kit.core.plan import Place

    return Place(*numbers(text, name, PLACE.form))
