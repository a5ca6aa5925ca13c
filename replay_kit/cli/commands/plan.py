"""``plan``: a glider's mission on an estimate."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from replay_kit.cli.commands.plan_learning import plan_learning, refuse_learning
from replay_kit.cli.commands.plan_options import Aim, Method, Outputs, Places, Times
from replay_kit.cli.console import console_beside, progress, write_json, write_text
from replay_kit.cli.options import TO_INPUTS, TO_OPTIONS, TO_OUTPUTS, argument, numbers, place
from replay_kit.cli.settings import Settings, takes_settings
from replay_kit.core.errors import ConfigError
from replay_kit.core.paths import check_inputs, check_paths

if TYPE_CHECKING:
    from replay_kit.workflows.planning.mission import PlannedMission
    from replay_kit.workflows.planning.request import MissionKind, PlanJob


# Exit code of a plan that is not safe enough to be handed to a vehicle.
_UNSAFE = 7


@takes_settings(
    "planner",
    without=[
        f"planner.{key}"
        for key in (
            "kind",
            "when",
            "interval",
            "flow_step",
            "objective",
            "min_angle",
            "max_angle",
            "bathymetry",
        )
    ],
    short="planner",
)
def plan(
    *flows: Annotated[
        Path,
        argument(
            "FLOW",
            "Estimate: a file of --save-estimate or a result of replay; several hold for increasing times.",
        ),
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
        raise ConfigError(
            "--geojson, --csv and --json: only one of them can have standard output; give the others files"
        )
    others = aim.others or ()
    check_paths(
        [*flows, *others, settings.file, places.no_go, places.bathymetry],
        [outputs.out, outputs.waypoints, *streams],
        outputs.overwrite,
    )
    least, most = _pair(method.angles, "--angles", "MIN,MAX") or (None, None)
    config = settings.load(planner={"min_angle": least, "max_angle": most})

    if aim.objective in ("learn", "map"):
        return plan_learning(flows, (places, times, aim, method, outputs), config)
    refuse_learning(places.goal, aim)
    job = _job(flows, places, times, aim, method, outputs)
    if job.bathymetry is None:
        job = replace(job, bathymetry=config.planner.bathymetry_path)
    check_inputs([*job.flows, job.no_go, job.bathymetry])

    # what takes long to load, after what is quickly refused
    from replay_kit.workflows.planning.mission import make_mission

    with progress():
        planned = make_mission(job, config.planner)

    from replay_kit.workflows.planning.outputs import (
        mission_json,
        print_mission,
        unsafe_reason,
        write_mission,
    )

    console, unsafe = console_beside(*streams), unsafe_reason(planned, job)
    withheld = unsafe is not None and not outputs.write_unsafe
    try:
        write_json(outputs.json_file, mission_json(planned))
        if not withheld:
            _write(planned, outputs)
            if outputs.out is not None:
                asked = _asked(places, times, aim, method, job.kind)
                write_mission(outputs.out, outputs.overwrite, planned, job, asked, config)
    finally:
        # after the files, which a reader of the first lines alone would end; and also where one cannot be written
        print_mission(planned, console, job.battery)
    if withheld:
        console.print(f"{unsafe}; no other file is written without --write-unsafe", soft_wrap=True)
    return 0 if unsafe is None else _UNSAFE


def _job(
    flows: tuple[Path, ...],
    places: Places,
    times: Times,
    aim: Aim,
    method: Method,
    outputs: Outputs,
) -> "PlanJob":
    """Return the mission asked for, checked."""
    from replay_kit.workflows.planning.request import (
        MissionKind,
        PlanJob,
        departures_of,
        horizon_of,
        start_time_of,
    )

    mooring = _pair(aim.mooring, "--mooring", "RADIUS,HOURS")
    kind = MissionKind(
        mooring, aim.surfacings_only, aim.line, aim.line_weight, aim.objective, aim.line_width
    )
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


def _asked(
    places: Places, times: Times, aim: Aim, method: Method, kind: "MissionKind"
) -> dict[str, object]:
    """Return what was asked for beyond the configuration, as it was given."""
    line = kind.followed
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
        "line_weight": line and line.weight,
        "line_width": line and line.width,
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
