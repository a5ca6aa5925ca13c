"""``plan``: a glider's mission on an estimate."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, get_args

from replay_kit.cli.commands.plan_learning import Learning, plan_learning, refuse_learning
from replay_kit.cli.console import console_beside, progress, write_json, write_text
from replay_kit.cli.options import (
    MCAP,
    PLACE,
    TO_INPUTS,
    TO_OPTIONS,
    TO_OUTPUTS,
    Answer,
    Ending,
    Numbers,
    argument,
    flag,
    numbers,
    option,
    place,
)
from replay_kit.cli.settings import Settings, takes_settings
from replay_kit.core.errors import ConfigError
from replay_kit.core.objective import ObjectiveName
from replay_kit.core.paths import check_paths

if TYPE_CHECKING:
    from replay_kit.workflows.planning.mission import PlannedMission
    from replay_kit.workflows.planning.request import PlanJob


# Exit code of a plan that is not safe enough to be handed to a vehicle.
_UNSAFE = 7


@dataclass(frozen=True, slots=True, kw_only=True)
class Places:
    """From where to where, and what must be kept clear of."""

    start: Annotated[str, option("--start", "Where the mission begins [degrees, degrees, m].", metavar="LON,LAT,DEPTH"), PLACE]
    goal: Annotated[
        list[str] | None, option("--goal", "Where to go [degrees, degrees, m]; may be repeated, in order.", metavar="LON,LAT,DEPTH"), PLACE
    ] = None
    no_go: Annotated[
        Path | None,
        option(
            "--no-go", "Polygons that the glider must not enter; with the property surface_only dives may pass below.", metavar="GEOJSON"
        ),
    ] = None
    bathymetry: Annotated[Path | None, option("--bathymetry", "Depth of the bottom on a grid.", metavar="FILE.nc")] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Times:
    """When the mission begins, and how far it is planned."""

    start_time: Annotated[
        str | None, option("--start-time", "When the mission begins, ISO 8601 UTC. Default: the time of the estimate.", metavar="TIME")
    ] = None
    depart: Annotated[
        str | None,
        option("--depart", "Departures that are compared, from T0 to T1; the best by the objective is planned.", metavar="T0,T1,STEP"),
    ] = None
    horizon: Annotated[
        str | None,
        option("--horizon", "Plan no further than this after the start, such as 72h, and say what is left then.", metavar="DURATION"),
    ] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Aim(Learning):
    """What the mission is for."""

    objective: Annotated[
        str | None,
        option(
            "--objective",
            f"What is minimised: {', '.join(get_args(ObjectiveName))}, or weights of hours, kJ and km from the goal, as "
            "time=1,energy=0.02,closest=5; learn: the error after a survey, map: that of the current in a box. Default: time.",
            metavar="NAME|WEIGHTS",
        ),
    ] = None
    mooring: Annotated[
        str | None,
        option("--mooring", "Stay within a radius of the goal [m] for a duration [hours].", metavar="RADIUS,HOURS"),
        Numbers("RADIUS,HOURS"),
    ] = None
    surfacings_only: Annotated[
        bool, flag("--surfacings-only", "With --mooring, only surfacings must lie within the radius, not the track between them.")
    ] = False
    line: Annotated[bool, flag("--line", "Follow the line from the start to the goal.")] = False
    line_weight: Annotated[float | None, option("--line-weight", "Cross-track penalty with --line [h per h and km].", least=0.0)] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Method:
    """How the mission is planned."""

    angles: Annotated[
        str | None,
        option("--angles", "Shallowest and steepest glide angle [degrees]. Default: 15,35.", metavar="MIN,MAX"),
        Numbers("MIN,MAX"),
    ] = None
    spline: Annotated[
        int, option("--spline", "Points per kernel length of the B-spline used for the optimisation; 0 uses the estimate itself.", least=0)
    ] = 4
    risk: Annotated[
        float | None,
        option("--risk", "Keep a margin such that at most this share of the samples violates a constraint.", metavar="SHARE"),
    ] = None
    arrive: Annotated[
        float, option("--arrive", "Share of the samples that must arrive for the plan to be called reached.", metavar="SHARE")
    ] = 0.9
    time_limit: Annotated[
        float | None, option("--time-limit", "After this time no other number of legs, way or margin is tried [s].", metavar="SECONDS")
    ] = None
    battery: Annotated[float | None, option("--battery", "Energy that the vehicle has [MJ].", metavar="MJ")] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Outputs(Answer):
    """What is written."""

    out: Annotated[Path | None, option("--out -o", "Predicted track and legs, for any MCAP viewer.", metavar="PLAN.mcap"), MCAP] = None
    geojson: Annotated[
        Path | None,
        option("--geojson", "Track, surfacings and goals; - is standard output.", metavar="FILE"),
        Ending((".geojson", ".json"), stream=True),
    ] = None
    csv: Annotated[
        Path | None, option("--csv", "One line for each leg; - is standard output.", metavar="FILE"), Ending((".csv",), stream=True)
    ] = None
    waypoints: Annotated[
        Path | None,
        option(
            "--waypoints",
            "Short list of places to head for: .csv, .geojson, .json, .kml, .plan for QGroundControl, .ma for a Slocum (yo*.ma: dives), "
            ".targets for a Seaglider.",
            metavar="FILE",
        ),
        Ending((".csv", ".geojson", ".json", ".kml", ".plan", ".ma", ".targets")),
    ] = None
    write_unsafe: Annotated[
        bool, flag("--write-unsafe", "Write files of a plan that violates a constraint more often than accepted, or of such waypoints.")
    ] = False
    waypoint_tolerance: Annotated[
        float | None,
        option(
            "--waypoint-tolerance",
            "Distance off the track within which no waypoint is needed [m]. Default: the tolerance of the plan.",
            least=0.0,
        ),
    ] = None


@takes_settings(
    "planner",
    without=[f"planner.{key}" for key in ("kind", "when", "interval", "flow_step", "objective", "min_angle", "max_angle", "bathymetry")],
    short="planner",
)
def plan(
    *flows: Annotated[
        Path, argument("FLOW", "Estimate: a file of --save-estimate or a result of replay; several hold for increasing times.")
    ],
    places: Annotated[Places, TO_INPUTS],
    times: Annotated[Times, TO_OPTIONS] = Times(),
    aim: Annotated[Aim, TO_OPTIONS] = Aim(),
    method: Annotated[Method, TO_OPTIONS] = Method(),
    settings: Settings,
    outputs: Annotated[Outputs, TO_OUTPUTS] = Outputs(),
) -> int:
    """Return 0, or 7 when the risk asked for cannot be kept or waypoints are not safe; a plan that cannot reach its goal is a result."""
    streams = outputs.geojson, outputs.csv, outputs.json_file
    if sum(str(path) == "-" for path in streams) > 1:
        raise ConfigError("--geojson, --csv and --json: only one of them can have standard output; give the others files")
    others = aim.others or ()
    check_paths(
        [*flows, *others, settings.file, places.no_go, places.bathymetry], [outputs.out, outputs.waypoints, *streams], outputs.overwrite
    )
    least, most = _pair(method.angles, "--angles", "MIN,MAX") or (None, None)
    config = settings.load(planner={"min_angle": least, "max_angle": most})

    if aim.objective in ("learn", "map"):
        return plan_learning(flows, (places, times, aim, method, outputs), config)
    refuse_learning(places.goal, aim)
    from replay_kit.workflows.planning.mission import make_mission
    from replay_kit.workflows.planning.outputs import mission_json, print_mission, unsafe_reason, write_mission

    job = _job(flows, places, times, aim, method, outputs)
    if job.bathymetry is None:
        job = replace(job, bathymetry=config.planner.bathymetry_path)
    with progress():
        planned = make_mission(job, config.planner)
    console, unsafe = console_beside(*streams), unsafe_reason(planned, job)
    print_mission(planned, console, job.battery)
    write_json(outputs.json_file, mission_json(planned))
    if unsafe is not None and not outputs.write_unsafe:
        console.print(f"{unsafe}; no other file is written without --write-unsafe", soft_wrap=True)
        return _UNSAFE
    _write(planned, outputs)
    if outputs.out is not None:
        write_mission(outputs.out, outputs.overwrite, planned, job, _asked(places, times, aim, method, job.kind.cross_track_weight), config)
    return 0 if unsafe is None else _UNSAFE


def _job(flows: tuple[Path, ...], places: Places, times: Times, aim: Aim, method: Method, outputs: Outputs) -> "PlanJob":
    """Return the mission asked for, checked."""
    from replay_kit.workflows.planning.request import MissionKind, PlanJob, departures_of, horizon_of, start_time_of

    kind = MissionKind(_pair(aim.mooring, "--mooring", "RADIUS,HOURS"), aim.surfacings_only, aim.line, aim.line_weight, aim.objective)
    job = PlanJob(
        flows,
        place(places.start, "--start"),
        tuple(place(text, "--goal") for text in places.goal or ()),
        kind=kind,
        no_go=places.no_go,
        bathymetry=places.bathymetry,
        spline=method.spline,
        risk=method.risk,
        waypoints=outputs.waypoints is not None,
        waypoint_tolerance=outputs.waypoint_tolerance,
        arrive=method.arrive,
        time_limit=method.time_limit,
        battery=method.battery,
        start_time_ns=None if times.start_time is None else start_time_of(times.start_time),
        departures_ns=() if times.depart is None else departures_of(times.depart),
        horizon=None if times.horizon is None else horizon_of(times.horizon),
    )
    job.check()
    return job


def _asked(places: Places, times: Times, aim: Aim, method: Method, line_weight: float | None) -> dict[str, object]:
    """Return what was asked for beyond the configuration, as it was given."""
    return {
        "start": places.start,
        "goals": " ".join(places.goal or ()),
        "objective": aim.objective,
        "mooring": aim.mooring,
        "spline": method.spline,
        "risk": method.risk,
        "arrive": method.arrive,
        "time_limit": method.time_limit,
        "surfacings_only": aim.surfacings_only,
        "line_weight": line_weight,
        "start_time": times.start_time,
        "depart": times.depart,
        "horizon": times.horizon,
    }


def _write(planned: "PlannedMission", outputs: Outputs) -> None:
    """Write the mission in each text format that is asked for."""
    from replay_kit.workflows.planning.outputs import mission_csv, mission_geojson, waypoint_file

    if outputs.geojson is not None:
        write_text(outputs.geojson, mission_geojson(planned))
    if outputs.csv is not None:
        write_text(outputs.csv, mission_csv(planned))
    if outputs.waypoints is not None and planned.waypoints is not None:
        write_text(outputs.waypoints, waypoint_file(planned.waypoints, outputs.waypoints))


def _pair(text: str | None, name: str, form: str) -> tuple[float, float] | None:
    """Return the two numbers of an option; None when it is not given."""
    if text is None:
        return None
    first, second = numbers(text, name, form)
    return first, second
