"""``plan``: a glider's mission on an estimate."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from replay_kit.cli.console import console_beside, progress, write_json, write_text
from replay_kit.cli.options import (
    CHOICES,
    FLAG,
    MCAP,
    TO_OUTPUTS,
    Answer,
    Ending,
    argument,
    option,
)
from replay_kit.cli.settings import Settings, takes_settings
from replay_kit.config.option import Numbers, numbers
from replay_kit.core.errors import ConfigError
from replay_kit.core.paths import check_inputs, check_paths

if TYPE_CHECKING:
    from replay_kit.config.run import RunConfig
    from replay_kit.workflows.planning.mission import PlannedMission


# Exit code of a plan that is not safe enough to be handed to a vehicle.
_UNSAFE = 7
_ANGLES = Numbers("MIN,MAX")


@dataclass(frozen=True, slots=True, kw_only=True)
class Outputs(Answer):
    """What is written.

    Attributes:
        out: Predicted track and legs (MCAP).
        geojson: Track, surfacings and goals; - is standard output.
        csv: One row per leg; - is standard output.
        waypoints: Waypoint file: .csv, .geojson, .json, .kml, .plan for QGroundControl, .ma for a Slocum (yo*.ma: dives), .targets or
            .science for a Seaglider.
        write_unsafe: Write files even if the plan or its waypoints violate a constraint more often than accepted.
    """

    out: Annotated[Path | None, option("PLAN.mcap", alias="-o"), MCAP] = None
    geojson: Annotated[Path | None, option("FILE"), Ending((".geojson", ".json"), stream=True)] = (
        None
    )
    csv: Annotated[Path | None, option("FILE"), Ending((".csv",), stream=True)] = None
    waypoints: Annotated[
        Path | None,
        option("FILE"),
        Ending((".csv", ".geojson", ".json", ".kml", ".plan", ".ma", ".targets", ".science")),
    ] = None
    write_unsafe: Annotated[bool, FLAG] = False

    def of(self, name: str) -> "Outputs":
        """Return the files of one of several gliders: its name stands before their ending."""

        def own(path: Path | None) -> Path | None:
            return None if path is None else path.with_stem(f"{path.stem}-{name}")

        files = {"out": own(self.out), "geojson": own(self.geojson), "csv": own(self.csv)}
        return replace(self, **files, waypoints=own(self.waypoints))  # type: ignore[arg-type]


@takes_settings(
    "plan",
    *(
        f"planner.{key}"
        for key in (
            *("speed", "depth", "max_depth", "surface_time", "radius", "hotel", "thrust"),
            *("margin", "clearance", "max_duration", "max_legs", "samples"),
        )
    ),
)
def plan(
    *flows: Annotated[Path, argument("FLOW")],
    angles: Annotated[str | None, option("MIN,MAX", group=CHOICES), _ANGLES] = None,
    settings: Settings,
    outputs: Annotated[Outputs, TO_OUTPUTS] = Outputs(),
) -> int:
    """Return 0, also where no goal is reached; 4 after a damaged result; 7 where a risk cannot be kept or waypoints are not safe.

    Args:
        flows: Estimate: a file of --save-estimate or a result of replay; several hold for increasing times.
        angles: Shallowest and steepest glide angle [degrees]. Default: as flown where the speed is, else 15,35.
    """
    streams = outputs.geojson, outputs.csv, outputs.json_file
    if sum(str(path) == "-" for path in streams) > 1:
        raise ConfigError(
            "--geojson, --csv and --json: only one of them can have standard output; give the others files"
        )
    least, most = (None, None) if angles is None else numbers(angles, "--angles", _ANGLES.form)
    config = settings.load(planner={"min_angle": least, "max_angle": most})
    asked = {"flows": flows, "waypoints": outputs.waypoints is not None}
    if config.plan.bathymetry is None:
        asked["bathymetry"] = config.planner.bathymetry_path
    request = config.plan.model_copy(update=asked)
    files = [*flows, request.no_go, request.bathymetry]
    written = [outputs.out, outputs.waypoints, *streams]
    if request.glider:
        if "-" in (str(outputs.geojson), str(outputs.csv)):
            raise ConfigError("--geojson and --csv: expected files with --glider, one for each")
        each = [outputs.of(name) for name in request.glider_places]
        written = [path for own in each for path in (own.out, own.geojson, own.csv, own.waypoints)]
        written.append(outputs.json_file)
    check_paths([*files, settings.file], written, outputs.overwrite)

    # what takes long to load, after what is quickly refused
    from replay_kit.workflows.planning.request import checked, completed

    request = checked(completed(request))
    check_inputs(files)
    config = config.model_copy(update={"plan": request})
    if request.glider:
        return _together(config, outputs)
    return _mission(config, outputs)


def _mission(config: "RunConfig", outputs: Outputs) -> int:
    """Plan a mission and write it; return the exit code."""
    from replay_kit.workflows.planning.inputs import planned_on

    with progress():
        on = planned_on(config.plan, config.planner)
        # the planners, after places that they have no current for
        from replay_kit.workflows.planning.mission import make_mission

        planned = make_mission(config.plan, config.planner, on)

    from replay_kit.workflows.planning.outputs import (
        mission_json,
        print_mission,
        unsafe_reason,
    )

    console = console_beside(outputs.geojson, outputs.csv, outputs.json_file)
    unsafe = unsafe_reason(planned, config.plan)
    withheld = unsafe is not None and not outputs.write_unsafe
    try:
        write_json(outputs.json_file, mission_json(planned))
        if not withheld:
            _write_mission(planned, outputs, config)
    finally:
        # after the files, which a reader of the first lines alone would end; and also where one cannot be written
        print_mission(planned, console, config.plan.battery)
    if withheld:
        console.print(f"{unsafe}; no other file is written without --write-unsafe")
    return planned.on.exit_code if unsafe is None else _UNSAFE


def _write_mission(planned: "PlannedMission", outputs: Outputs, config: "RunConfig") -> None:
    """Write the mission in each format that is asked for."""
    from replay_kit.workflows.planning.outputs import (
        mission_csv,
        mission_geojson,
        waypoint_file,
        write_mission,
    )

    if outputs.geojson is not None:
        write_text(outputs.geojson, mission_geojson(planned))
    if outputs.csv is not None:
        write_text(outputs.csv, mission_csv(planned))
    if outputs.waypoints is not None and planned.waypoints is not None:
        write_text(outputs.waypoints, waypoint_file(planned.waypoints, outputs.waypoints))
    if outputs.out is not None:
        write_mission(outputs.out, outputs.overwrite, planned, config)


def _together(config: "RunConfig", outputs: Outputs) -> int:
    """Plan several gliders and write the files of each; return 0, or 4 when part of the result was lost."""
    from replay_kit.workflows.planning.together import make_together, print_together, together_json

    with progress():
        made = make_together(config.plan, config.planner)

    from replay_kit.workflows.planning.outputs import mission_json, print_mission, unsafe_reason

    console = console_beside(outputs.geojson, outputs.csv, outputs.json_file)
    unsafe = {name: unsafe_reason(one, config.plan) for name, one in made.planned.items()}
    withheld = {} if outputs.write_unsafe else {k: why for k, why in unsafe.items() if why}
    each = {name: mission_json(one) for name, one in made.planned.items()}
    try:
        write_json(outputs.json_file, together_json(made, each))
        for name, one in made.planned.items():
            if name in withheld:
                continue
            plan = config.plan.model_copy(update={"of_glider": name})
            _write_mission(one, outputs.of(name), config.model_copy(update={"plan": plan}))
    finally:
        print_together(made, console)
        for name, one in made.planned.items():
            console.print(f"\n{name}", style="bold")
            print_mission(one, console, config.plan.battery)
            if name in withheld:
                console.print(
                    f"{withheld[name]}; no file of {name} is written without --write-unsafe"
                )
    lost = max(one.on.exit_code for one in made.planned.values())
    return _UNSAFE if any(unsafe.values()) else lost
