"""The options of ``plan``, in groups."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, get_args

from replay_kit.cli.options import MCAP, PLACE, Answer, Ending, Numbers, flag, option
from replay_kit.core.objective import ObjectiveName


@dataclass(frozen=True, slots=True, kw_only=True)
class Places:
    """From where to where, and what must be kept clear of."""

    start: Annotated[
        str,
        option(
            "--start", "Where the mission begins [degrees, degrees, m].", metavar="LON,LAT,DEPTH"
        ),
        PLACE,
    ]
    goal: Annotated[
        list[str] | None,
        option(
            "--goal",
            "Where to go [degrees, degrees, m]; may be repeated, in order.",
            metavar="LON,LAT,DEPTH",
        ),
        PLACE,
    ] = None
    no_go: Annotated[
        Path | None,
        option(
            "--no-go",
            "Polygons that the glider must not enter; with the property surface_only dives may pass below.",
            metavar="GEOJSON",
        ),
    ] = None
    bathymetry: Annotated[
        Path | None, option("--bathymetry", "Depth of the bottom on a grid.", metavar="FILE.nc")
    ] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Times:
    """When the mission begins, and how far it is planned."""

    start_time: Annotated[
        str | None,
        option(
            "--start-time",
            "When the mission begins, ISO 8601 UTC. Default: the time of a result's last fix; of an estimate alone its time.",
            metavar="TIME",
        ),
    ] = None
    depart: Annotated[
        str | None,
        option(
            "--depart",
            "Departures that are compared, from T0 to T1. The one that arrives first is planned; with another --objective than time "
            "the best by it: time=1 plans the shortest mission.",
            metavar="T0,T1,STEP",
        ),
    ] = None
    horizon: Annotated[
        str | None,
        option(
            "--horizon",
            "Plan no further than this after the start, such as 72h, and say what is left then.",
            metavar="DURATION",
        ),
    ] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Learning:
    """Options of plans that learn (--objective learn and map)."""

    then: Annotated[
        str | None,
        option(
            "--then",
            "Where the stretch without fixes after a survey ends, past other places if given.",
            metavar="LON,LAT,DEPTH[,...]",
        ),
    ] = None
    blind: Annotated[
        float | None, option("--blind", "Duration of that stretch [h].", metavar="HOURS")
    ] = None
    survey: Annotated[
        float | None,
        option("--survey", "Duration of the survey before it [h]. Default: 24.", metavar="HOURS"),
    ] = None
    box: Annotated[
        str | None,
        option(
            "--box",
            "Box to be mapped [degrees], and depths [m]; without them the dives' mean.",
            metavar="W,S,E,N[,DEPTHS]",
        ),
    ] = None
    profiles: Annotated[
        int | None, option("--profiles", "Number of profiles of the map.", metavar="N")
    ] = None
    profile_error: Annotated[
        float,
        option(
            "--profile-error",
            "Standard deviation of the error of a profile's mean current, each component [m/s].",
        ),
    ] = 0.03
    others: Annotated[
        list[Path] | None,
        option(
            "--others",
            "Plan of another vehicle, whose profiles come anyway; may be repeated.",
            metavar="PLAN.mcap",
        ),
    ] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Aim(Learning):
    """What the mission is for."""

    objective: Annotated[
        str | None,
        option(
            "--objective",
            f"{', '.join(get_args(ObjectiveName))} or weights of hours, kJ and km from the goal, as time=1,energy=0.02,closest=5: what is "
            "minimised, or learn (measure before a stretch without fixes, with --then and --blind) or map "
            "(measure the current in a box, with --box and --profiles). Default: time.",
            metavar="NAME|WEIGHTS",
        ),
    ] = None
    mooring: Annotated[
        str | None,
        option(
            "--mooring",
            "Stay within a radius of the goal [m] for a duration [hours].",
            metavar="RADIUS,HOURS",
        ),
        Numbers("RADIUS,HOURS"),
    ] = None
    surfacings_only: Annotated[
        bool,
        flag(
            "--surfacings-only",
            "With --mooring, only surfacings must lie within the radius, not the track between them.",
        ),
    ] = False
    line: Annotated[bool, flag("--line", "Follow the line from the start to the goal.")] = False
    line_weight: Annotated[
        float | None,
        option("--line-weight", "Cross-track penalty with --line [h per h and km].", least=0.0),
    ] = None
    line_width: Annotated[
        float | None,
        option(
            "--line-width",
            "Largest distance of the track from the line for the mission to have reached its goal [m]. Default: 2000.",
        ),
    ] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Method:
    """How the mission is planned."""

    angles: Annotated[
        str | None,
        option(
            "--angles",
            "Shallowest and steepest glide angle [degrees]. Default: as flown where the speed is, else 15,35.",
            metavar="MIN,MAX",
        ),
        Numbers("MIN,MAX"),
    ] = None
    spline: Annotated[
        int,
        option(
            "--spline",
            "Points per kernel length of the B-spline used for the optimisation; 0 uses the estimate itself.",
            least=0,
        ),
    ] = 4
    risk: Annotated[
        float | None,
        option(
            "--risk",
            "Keep a margin such that at most this share of the samples violates a constraint.",
            metavar="SHARE",
        ),
    ] = None
    arrive: Annotated[
        float,
        option(
            "--arrive",
            "Share of the samples that must arrive for the plan to be called reached.",
            metavar="SHARE",
        ),
    ] = 0.9
    time_limit: Annotated[
        float | None,
        option(
            "--time-limit",
            "After this time no other number of legs, way or margin is tried [s].",
            metavar="SECONDS",
        ),
    ] = None
    battery: Annotated[
        float | None, option("--battery", "Energy that the vehicle has [MJ].", metavar="MJ")
    ] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Outputs(Answer):
    """What is written."""

    out: Annotated[
        Path | None,
        option("--out -o", "Predicted track and legs, for any MCAP viewer.", metavar="PLAN.mcap"),
        MCAP,
    ] = None
    geojson: Annotated[
        Path | None,
        option("--geojson", "Track, surfacings and goals; - is standard output.", metavar="FILE"),
        Ending((".geojson", ".json"), stream=True),
    ] = None
    csv: Annotated[
        Path | None,
        option("--csv", "One line for each leg; - is standard output.", metavar="FILE"),
        Ending((".csv",), stream=True),
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
        bool,
        flag(
            "--write-unsafe",
            "Write files of a plan that violates a constraint more often than accepted, or of such waypoints.",
        ),
    ] = False
    waypoint_tolerance: Annotated[
        float | None,
        option(
            "--waypoint-tolerance",
            "Distance off the track within which no waypoint is needed [m]. Default: the tolerance of the plan.",
            least=0.0,
        ),
    ] = None
