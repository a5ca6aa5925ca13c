"""Request of ``plan`` and its inputs: incompatible options are refused, values converted to those of the planners, files read.

Planners and what reads results are imported on use only, so that errors in options appear quickly.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from replay_kit.config.plan import PlanRequest
from replay_kit.config.planner import PlannerConfig
from replay_kit.core.errors import ConfigError, PlanError
from replay_kit.core.extensions import objective_names
from replay_kit.core.files.inputs import open_input
from replay_kit.core.files.paths import check_inputs
from replay_kit.core.words.progress import announce

if TYPE_CHECKING:
    from planners.hazards.areas import NoGo
    from planners.hazards.domain import Bathymetry
    from planners.request import Line, Mooring, Weights
    from replay_kit.core.as_flown import AsFlown
    from replay_kit.core.flow.estimate import FlowEstimate
    from replay_kit.core.grid import Grid
    from replay_kit.core.plan import Place
    from replay_kit.show.status.held import Fix
    from replay_kit.workflows.planning.currents import KnownCurrent

# Options that need another, and those that exclude others.
_NEEDS = {
    "waypoint_tolerance": "waypoints",
    "surfacings_only": "mooring",
    "line_width": "line",
    "separation": "glider",
}
_EXCLUDES = {
    "mooring": "line objective waypoints risk depart horizon arrive_by",
    "line": "risk depart horizon",
    "depart": "start_time risk horizon arrive_by",
    "horizon": "waypoints arrive_by",
    "glider": "start depart horizon mooring line risk arrive_by",
    "objective odds": "mooring line depart risk glider",
}
_POSITIVE = ("time_limit", "battery", "separation", "horizon_s", "line_width")


def completed_request(request: PlanRequest) -> tuple[PlanRequest, dict[Path, FlowFile]]:
    """Return a request with a missing start and goal from its result, and the files read for them.

    They are the last fix, and the goal of the run. Of a result of several vehicles those with a goal, in the request or else in the run,
    are planned together, each from its last fix.

    Raises:
        ReplayKitError: A file is missing, or the result cannot be read or lacks a vehicle.
    """
    if request.glider or (request.start and request.goal):
        return request, {}
    check_inputs(request.flows)
    if not request.flows or not is_result(request.flows[-1]):
        return request, {}
    file, named = read_flow(request.flows[-1]), {name for name, _ in request.goals_of_gliders}
    vehicles, several = ", ".join(file.offers), len(file.offers) > 1
    if several and request.start:
        raise ConfigError(f"--start: expected --glider NAME={request.start} with one of {vehicles}")
    if several and (unknown := named - {"", *file.offers}):
        raise ConfigError(f"--goal: expected NAME= of {vehicles}, got {', '.join(sorted(unknown))}")
    used = {
        name: one
        for name, one in file.offers.items()
        if not several or (one.fix and (named & {"", name} if named else one.goal))
    }
    goals = {name: ",".join(map(str, one.goal)) for name, one in used.items() if one.goal}
    starts = {
        name: f"{one.fix.longitude},{one.fix.latitude},0" for name, one in used.items() if one.fix
    }
    if len(starts) > 1:
        each, goals_by_name = (tuple(map("=".join, by_name.items())) for by_name in (starts, goals))
        found: dict[str, Any] = {"glider": each, "goal": request.goal or goals_by_name}
    else:
        name, start = next(iter(starts.items()), ("", None))
        found = {"start": request.start or start, "of_glider": name or None}
        stated = [text.rpartition("=")[2] if several else text for text in request.goal]
        found["goal"] = tuple(stated or goals.values())
    return request.model_copy(update=found), {file.path: file}


def checked_request(request: PlanRequest) -> PlanRequest:
    """Return a request checked before any file is read.

    Raises:
        ConfigError: Two options exclude each other, one needs another, or a value is invalid.
    """
    if not request.goal:
        raise ConfigError(
            "--goal is missing; expected --goal LON,LAT,DEPTH, or the result of a replay with a goal"
        )
    # read once, so that what is wrong with them is said before anything is loaded
    places = "glider_places goals_of_gliders" if request.glider else "start_place goals"
    for name in (*places.split(), "start_time_ns", "departures_ns"):
        getattr(request, name)
    request.arrive_by_s(request.start_time_ns or 0)
    _check_together(request)
    if request.risk is not None and not 0.0 <= request.risk < 1.0:
        raise ConfigError(f"--risk: expected a fraction from 0 to below 1, got {request.risk:g}")
    if not 0.0 <= request.arrive <= 1.0:
        raise ConfigError(f"--arrive: expected a fraction from 0 to 1, got {request.arrive:g}")
    for name in _POSITIVE:
        if (value := getattr(request, name)) is not None and not 0.0 < value < inf:
            option = _option(name.removesuffix("_s"))
            raise ConfigError(f"{option}: expected a number above 0, got {value:g}")
    if request.objective is not None:
        objective_of(request.objective)
    return request


def _option(name: str) -> str:
    return f"--{name.replace('_', '-')}"


def _check_together(request: PlanRequest) -> None:
    """Raise ConfigError for options that need another or exclude each other."""

    def given(name: str) -> bool:
        value = getattr(request, name, request.objective == name.rpartition(" ")[2])
        return value is not None and value is not False and value != ()

    for option, other in _NEEDS.items():
        if given(option) and not given(other):
            raise ConfigError(f"{_option(option)}: expected {_option(other)} too")
    for option, others in _EXCLUDES.items():
        beside = ", ".join(map(_option, filter(given, others.split())))
        if given(option) and beside:
            raise ConfigError(
                f"{_option(option)}: cannot be combined with {beside}; leave one of them out"
                + "; of a result of several vehicles --goal NAME= plans one" * (option == "glider")
            )
    if (request.mooring or request.line) and len(request.goal) > 1:
        raise ConfigError("--goal: expected one with --mooring and --line")
    if not request.glider:
        return
    if len(request.glider) < 2:
        raise ConfigError("--glider: expected two gliders or more; one has --start")
    named = [name for name, _ in request.goals_of_gliders if name]
    unknown = [name for name in named if name not in request.glider_places]
    if unknown or len(set(named)) < len(named):
        raise ConfigError(
            f"--goal: expected one for a glider of --glider, got {', '.join(unknown or named)}"
        )


def check_samples(request: PlanRequest, count: int, knows_errors: bool) -> None:
    """Raise an error for requested odds that the samples cannot give.

    Args:
        request: Request of the plan.
        count: Number of samples.
        knows_errors: Whether the estimate has an uncertainty.

    Raises:
        ConfigError: There are no samples.
        PlanError: The samples are all equal.
    """
    asked = "--risk" if request.risk is not None else "--objective odds"
    if request.risk is None and request.objective != "odds":
        return
    if not knows_errors:
        raise PlanError(
            f"{asked}: the estimate states no uncertainty (a truth, a member, a mean), so that it has no odds; give the result of a replay"
        )
    if count == 0:
        raise ConfigError(f"{asked}: expected --samples above 0, got 0")


def objective_of(text: str) -> str | Weights:
    """Return an objective's name, or its weights such as ``time=1,energy=0.02,closest=5``.

    Raises:
        ConfigError: The text is neither.
    """
    if text in objective_names():
        return text
    try:
        pairs = [part.partition("=") for part in text.split(",")]
        weights = {name: float(value) for name, _, value in pairs}

        from planners.request import Weights

        return Weights(**weights)
    except (TypeError, ValueError, PlanError) as error:
        known = ", ".join(objective_names())
        raise ConfigError(
            f"--objective: expected one of {known}, or weights time=A,energy=B,closest=C, got {text!r}"
        ) from error


def shape_of(request: PlanRequest) -> Line | Mooring | None:
    """Return the line or mooring of a checked request; None for other missions."""
    from planners.request import Line, Mooring

    if request.mooring_numbers is not None:
        radius, hours = request.mooring_numbers
        return Mooring(radius, 3600.0 * hours, request.surfacings_only)
    if not request.line:
        return None
    return Line() if request.line_width is None else Line(width=request.line_width)


# ---- inputs


@dataclass(frozen=True, slots=True, eq=False)
class PlannedOn:
    """Inputs of a plan.

    Attributes:
        known: Current.
        flown: Known flight parameters by vehicle name, empty for a single one.
        no_go: No-go areas.
        bathymetry: Bottom depth; None without one.
        notes: Notes on the files.
        exit_code: 4 if part of a file was lost, else 0.
    """

    known: KnownCurrent
    flown: Mapping[str, AsFlown]
    no_go: tuple[NoGo, ...]
    bathymetry: Bathymetry | None
    notes: tuple[str, ...]
    exit_code: int = 0

    @property
    def region(self) -> Grid:
        """Region of the estimate."""
        return self.known.first.grid


class Offer(NamedTuple):
    """What a file with an estimate offers for the request of a vehicle; None for what it does not hold.

    Attributes:
        fix: Last fix.
        goal: Goal of the run: longitude, latitude [degrees] and depth [m].
        flown: Flight parameters.
    """

    fix: Fix | None
    goal: tuple[float, float, float] | None
    flown: AsFlown | None


@dataclass(frozen=True, slots=True, eq=False)
class FlowFile:
    """Content of a file with an estimate.

    Attributes:
        path: The file.
        flows: Estimates of its windows in order; the last one is that of its end.
        offers: What it offers for a request by vehicle, empty name for a single one.
        notes: Losses of the file, or a missing checksum.
        exit_code: Exit code of a command that uses it: 4 if something was lost, else 0.
    """

    path: Path
    flows: tuple[FlowEstimate, ...]
    offers: Mapping[str, Offer]
    notes: tuple[str, ...] = ()
    exit_code: int = 0

    def at(self, places: Sequence[Place] = ()) -> FlowEstimate:
        """Return the estimate of the last window that holds places; of the last one if none does."""
        from replay_kit.core.region import bounds_of, inside_box

        for flow in reversed(self.flows):
            box = bounds_of(flow.grid)
            if all(inside_box(box, place.longitude, place.latitude) for place in places):
                return flow
        return self.flows[-1]


def planned_on(
    request: PlanRequest, config: PlannerConfig, known: Mapping[Path, FlowFile] | None = None
) -> PlannedOn:
    """Return the inputs of a plan, read from the files of its request.

    Args:
        request: Request of the plan.
        config: ``[planner]``.
        known: Files that were read already.

    Raises:
        ReplayKitError: A file cannot be read, the estimates are not in order of time, or a place is outside their water.
    """
    from planners.hazards.domain import Region, locate_all

    announce("reading the estimate")
    files = [(known or {}).get(path) or read_flow(path) for path in request.flows]
    places = () if request.glider else (request.start_place, *request.goals)
    region, bottom = files[0].at(places).grid, None
    if not (request.glider or request.mooring):
        locate_all(Region(region, config.depth_limit), request.start_place, request.goals)
    current, flown = read_known(files, config.flow_step, places)
    areas: tuple[NoGo, ...] = ()
    notes = tuple(note for file in files for note in file.notes)
    if request.no_go is not None:
        from replay_kit.workflows.planning.areas import area_notes, read_areas

        areas = read_areas(request.no_go)
        notes += area_notes(request.no_go, areas, region)
    if request.bathymetry is not None:
        from replay_kit.workflows.planning.bathymetry import bathymetry_notes, read_bathymetry

        bottom = read_bathymetry(request.bathymetry, region)
        notes += bathymetry_notes(bottom, region)
    return PlannedOn(current, flown, areas, bottom, notes, max(file.exit_code for file in files))


def read_known(
    files: Sequence[FlowFile], flow_step: float, places: Sequence[Place] = ()
) -> tuple[KnownCurrent, dict[str, AsFlown]]:
    """Return the current in one or more files, and the latest flight parameters in them by vehicle name.

    The times of the last fixes are known for a single result.

    Args:
        files: Files, several in order of time.
        flow_step: Time between the flows of a changing estimate [s].
        places: Positions that select the window of a result.

    Raises:
        ReplayKitError: The files are not in order of time.
    """
    from replay_kit.workflows.planning.currents import known_current

    known = known_current([(file.path, file.at(places)) for file in files], flow_step)
    if len(files) == 1:
        held = files[0].offers.items()
        known = replace(known, fixes={name: one.fix.time_ns for name, one in held if one.fix})
    flown = ((name, one.flown) for file in files for name, one in file.offers.items() if one.flown)
    return known, dict(flown)


def read_flow(path: Path) -> FlowFile:
    """Return the content of a NetCDF file of ``--save-estimate`` or a result MCAP, recognised by its first bytes.

    Raises:
        ReplayKitError: The file is missing or has no estimate.
    """
    from replay_kit.core.as_flown import AS_FLOWN, AsFlown

    if not is_result(path):
        from replay_kit.core.flow.file import load

        flow = load(path)
        saved = {name: json.loads(text) for name, text in flow.about.items() if name == AS_FLOWN}
        return FlowFile(path, (flow,), {"": Offer(None, None, AsFlown.in_metadata(saved))})
    from replay_kit.results.reader import ResultReader
    from replay_kit.workflows.sound import sound_result
    from replay_kit.workflows.status import read_each

    with sound_result(path) as sound:
        reader = ResultReader(sound.path, opened=sound.file)
        offers = {
            name: Offer(
                held.fixes[-1] if held.fixes else None,
                held.goal,
                AsFlown.in_metadata(held.metadata),
            )
            for name, held in read_each(reader).items()
        }
        return FlowFile(path, reader.estimates(), offers, sound.lines, sound.exit_code)


def is_result(path: Path) -> bool:
    """Return whether a file is a result, by its first bytes."""
    with suppress(OSError), open_input(path) as file:
        return file.read(5) == b"\x89MCAP"
    return False
