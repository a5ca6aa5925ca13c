"""Request of ``plan``: incompatible options are refused, values converted to those of the planners.

Planners are imported on use only, so that errors in options appear quickly.
"""

from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Any

from replay_kit.config.plan import PlanRequest
from replay_kit.config.removed import refuse_value
from replay_kit.core.errors import ConfigError, PlanError
from replay_kit.core.extensions import is_objective, objective_names

if TYPE_CHECKING:
    from planners.request import Line, Mooring, Weights
    from replay_kit.workflows.planning.inputs import FlowFile


def completed(request: PlanRequest) -> "tuple[PlanRequest, dict[Path, FlowFile]]":
    """Return a request with a missing start and goal from its result, and the files read for them.

    They are the last fix, and the goal of the run. Of a result of several vehicles those with a goal are planned together, each from its
    last fix.

    Raises:
        ReplayKitError: The result cannot be read.
    """
    if request.glider or not request.flows or (request.start is not None and request.goal):
        return request, {}
    from replay_kit.workflows.planning.inputs import is_result, read_flow

    if not is_result(request.flows[-1]):
        return request, {}
    file = read_flow(request.flows[-1])
    several, starts, goals = len(file.held) > 1, dict[str, str](), dict[str, str]()
    if several and (request.start is not None or request.goal):
        raise ConfigError(
            f"--start and --goal: expected both, or neither, for a result of several vehicles ({', '.join(file.held)}), got one of them"
        )
    for name, held in file.held.items():
        if several and not (held.fixes and held.goal):
            continue
        if held.fixes:
            starts[name] = f"{held.fixes[-1].longitude},{held.fixes[-1].latitude},0"
        if held.goal:
            goals[name] = ",".join(map(str, held.goal))
    found: dict[str, Any] = {}
    if len(starts) > 1:
        found["glider"] = tuple(f"{name}={start}" for name, start in starts.items())
        found["goal"] = tuple(f"{name}={goal}" for name, goal in goals.items())
    else:
        found["start"] = request.start or next(iter(starts.values()), None)
        found["goal"] = request.goal or tuple(goals.values())
        found["of_glider"] = next(iter(starts), "") or None
    return request.model_copy(update=found), {file.path: file}


def checked(request: PlanRequest) -> PlanRequest:
    """Return a request checked before any file is read, with default weight and width of its line.

    Raises:
        ConfigError: Options are incompatible, or a value is invalid.
    """
    _check(request)
    if request.objective is not None:
        objective_of(request.objective)
    if not request.line:
        return request
    from planners.request import Line

    usual = {"line_weight": Line().weight, "line_width": Line().width}
    return request.model_copy(
        update={name: value for name, value in usual.items() if getattr(request, name) is None}
    )


def _check(request: PlanRequest) -> None:
    """Raise ConfigError for values out of range and incompatible options.

    Raises:
        ConfigError: Two options exclude each other, one needs another, or a value is invalid.
    """
    if not request.goal:
        raise ConfigError(
            "--goal is missing; expected --goal LON,LAT,DEPTH, or the result of a replay with a goal"
        )
    # read once, so that what is wrong with them is said before anything is loaded
    _ = (
        *(
            (request.glider_places, request.goals_of_gliders)
            if request.glider
            else (request.start_place, request.goals)
        ),
        request.start_time_ns,
        request.departures_ns,
        request.arrive_by_s(request.start_time_ns or 0),
    )
    _check_together(request)
    if request.risk is not None and not 0.0 <= request.risk < 1.0:
        raise ConfigError(f"--risk: expected a fraction from 0 to below 1, got {request.risk:g}")
    if not 0.0 <= request.arrive <= 1.0:
        raise ConfigError(f"--arrive: expected a fraction from 0 to 1, got {request.arrive:g}")
    for name in (
        "time_limit",
        "battery",
        "separation",
        "horizon_s",
        "line_width",
    ):
        if (value := getattr(request, name)) is not None and not 0.0 < value < inf:
            option = name.removesuffix("_s").replace("_", "-")
            raise ConfigError(f"--{option}: expected a number above 0, got {value:g}")


# Options that need another, and those that exclude others.
_NEEDS = {
    "waypoint_tolerance": "waypoints",
    "surfacings_only": "mooring",
    "line_weight": "line",
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


def _check_together(request: PlanRequest) -> None:
    """Raise ConfigError for options that need another or exclude each other.

    Raises:
        ConfigError: Options are incompatible.
    """

    def given(name: str) -> bool:
        value = getattr(request, name, request.objective == name.rpartition(" ")[2])
        return value is not None and value is not False and value != ()

    def words(name: str) -> str:
        return f"--{name.replace('_', '-')}"

    for option, other in _NEEDS.items():
        if given(option) and not given(other):
            raise ConfigError(f"{words(option)}: expected {words(other)} too")
    for option, others in _EXCLUDES.items():
        beside = ", ".join(words(other) for other in others.split() if given(other))
        if given(option) and beside:
            raise ConfigError(
                f"{words(option)}: cannot be combined with {beside}; leave one of them out"
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


def objective_of(text: str) -> "str | Weights":
    """Return an objective's name, or its weights such as ``time=1,energy=0.02,closest=5``.

    Raises:
        ConfigError: The text is neither.
    """
    if is_objective(text):
        return text
    refuse_value("--objective", text)
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


def shape_of(request: PlanRequest) -> "Line | Mooring | None":
    """Return the line or mooring of a checked request; None for other missions."""
    from planners.request import Line, Mooring

    if request.mooring_numbers is not None:
        radius, hours = request.mooring_numbers
        return Mooring(radius, 3600.0 * hours, request.surfacings_only)
    weight, width = request.line_weight, request.line_width
    return None if weight is None or width is None else Line(weight=weight, width=width)
