"""``plan``: a glider mission on an estimate."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from replay_kit.cli.console import progress, write_text
from replay_kit.cli.options import (
    CHOICES,
    MCAP,
    TO_OUTPUTS,
    Answer,
    Ending,
    Switch,
    argument,
    option,
    output,
)
from replay_kit.cli.settings import Settings, takes_settings
from replay_kit.config.option import Numbers, numbers
from replay_kit.core.errors import ConfigError
from replay_kit.core.files.paths import check_inputs, check_paths

if TYPE_CHECKING:
    from replay_kit.config.run import RunConfig
    from replay_kit.workflows.planning.request import FlowFile


# Exit code of a plan that is not safe enough to be handed to a vehicle.
_UNSAFE = 7
_ANGLES = Numbers("MIN,MAX")


@TO_OUTPUTS
@dataclass(frozen=True, slots=True, kw_only=True)
class Outputs(Answer):
    """Outputs of ``plan``.

    Attributes:
        out: Predicted track and legs (MCAP).
        geojson: Track, surfacings and goals; - is standard output.
        csv: One row per leg; - is standard output.
        waypoints: Waypoint file: .csv, .geojson, .json, .kml, .plan for QGroundControl, .ma for a Slocum (yo*.ma: dives), .targets or
            .science for a Seaglider.
        write_unsafe: Write files even if the plan or its waypoints violate a constraint more often than accepted.
    """

    out: Annotated[Path | None, output("PLAN.mcap"), MCAP] = None
    geojson: Annotated[Path | None, option("FILE"), Ending((".geojson", ".json"), stream=True)] = (
        None
    )
    csv: Annotated[Path | None, option("FILE"), Ending((".csv",), stream=True)] = None
    waypoints: Annotated[
        Path | None,
        option("FILE"),
        Ending((".csv", ".geojson", ".json", ".kml", ".plan", ".ma", ".targets", ".science")),
    ] = None
    write_unsafe: Switch = False

    def for_vehicle(self, name: str) -> "Outputs":
        """Return the files of one of several gliders, its name inserted before the ending."""
        names = "out", "geojson", "csv", "waypoints"
        files = {key: path for key in names if (path := getattr(self, key)) is not None}
        return replace(
            self, **{key: path.with_stem(f"{path.stem}-{name}") for key, path in files.items()}
        )


_OF_PLANNER = (
    "speed depth max_depth surface_time radius hotel thrust margin clearance max_duration max_legs "
    "samples"
)


@takes_settings("plan", *(f"planner.{key}" for key in _OF_PLANNER.split()))
def plan(
    *flows: Annotated[Path, argument("FLOW")],
    angles: Annotated[str | None, option("MIN,MAX", group=CHOICES), _ANGLES] = None,
    settings: Settings,
    outputs: Outputs = Outputs(),
) -> int:
    """Return exit code 0, also if no goal is reached; 4 for a damaged result; 7 for an exceeded risk or unsafe waypoints.

    Args:
        flows: Estimate: a file of --save-estimate or a result of replay; several in order of time.
        angles: Shallowest and steepest glide angle [degrees]. Default: as flown if the speed is, else 15,35.
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
        each = [outputs.for_vehicle(name) for name in request.glider_places]
        written = [
            path
            for of_plan in each
            for path in (of_plan.out, of_plan.geojson, of_plan.csv, of_plan.waypoints)
        ]
        written.append(outputs.json_file)
    check_paths([*files, settings.file], written, outputs.overwrite)

    # what takes long to load, after what is quickly refused
    from replay_kit.workflows.planning.request import checked_request, completed_request

    request, known = completed_request(request)
    request = checked_request(request)
    check_inputs(files)
    return _plan(config.model_copy(update={"plan": request}), outputs, known)


def _plan(config: "RunConfig", outputs: Outputs, known: "Mapping[Path, FlowFile]") -> int:
    """Plan one mission or one per glider, write the files and return the exit code."""
    from replay_kit.workflows.planning.request import planned_on

    with progress(config.output.threads):
        on = planned_on(config.plan, config.planner, known)
        # the planners, after places that they have no current for
        from replay_kit.workflows.planning.run import make_plans

        made = make_plans(config.plan, config.planner, on)

    from replay_kit.workflows.planning.outputs import (
        plans_json,
        print_plans,
        texts_of,
        unsafe_reason,
    )

    console = outputs.console(outputs.geojson, outputs.csv)
    unsafe = {
        name: why for name, one in made.planned.items() if (why := unsafe_reason(one)) is not None
    }
    withheld = {} if outputs.write_unsafe else unsafe
    try:
        outputs.write(plans_json(made))
        for name, one in made.planned.items():
            files = outputs.for_vehicle(name) if name else outputs
            if name in withheld:
                continue
            for path, text in texts_of(one, files.geojson, files.csv, files.waypoints):
                write_text(path, text)
            if files.out is not None:
                # with what it records of a replay
                from replay_kit.workflows.planning.record import write_mission

                plan = config.plan.model_copy(update={"of_glider": name} if name else {})
                write_mission(
                    files.out, files.overwrite, one, config.model_copy(update={"plan": plan})
                )
    finally:
        # after the files, which a reader of the first lines alone would end; and also where one cannot be written
        print_plans(made, console, withheld)
    return _UNSAFE if unsafe else on.exit_code
