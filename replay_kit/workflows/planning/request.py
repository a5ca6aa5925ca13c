"""What ``plan`` is asked for, with options that exclude each other refused, and made the planners' own values.

The planners take longer to load than what is wrong takes to be refused.
"""

from math import inf
from typing import TYPE_CHECKING, Any

from replay_kit.config.plan import PlanRequest
from replay_kit.config.removed import refuse_value
from replay_kit.core.errors import ConfigError, PlanError
from replay_kit.core.extensions import is_objective, objective_names

if TYPE_CHECKING:
    from planners.request import Line, Mooring, Weights


def completed(request: PlanRequest) -> PlanRequest:
    """Return a request with the start and the goal that are not given taken from its result: the last fix, and the goal of the run.

    Raises:
        ReplayKitError: The result cannot be read.
    """
    if request.glider or not request.flows or (request.start is not None and request.goal):
        return request
    from replay_kit.show.status.figures import goal_of
    from replay_kit.workflows.planning.inputs import held_of

    held = held_of(request.flows[-1])
    if held is None:
        return request
    found: dict[str, Any] = {}
    if request.start is None and held.fixes:
        fix = held.fixes[-1]
        found["start"] = f"{fix.longitude},{fix.latitude},0"
    if not request.goal and (goal := goal_of(held)) is not None:
        found["goal"] = (",".join(map(str, goal)),)
    return request.model_copy(update=found)


def checked(request: PlanRequest) -> PlanRequest:
    """Return a request, checked before any file is read, with the weight and the width of the line that it follows.

    Raises:
        ConfigError: Options do not go together, or a value is none.
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
    """Refuse values out of range, and options that do not go together.

    Raises:
        ConfigError: Two options exclude each other, or one needs another that is not given, or a value is none.
    """
    if not request.goal:
        raise ConfigError("--goal: expected LON,LAT,DEPTH, where to go")
    # read once, so that what is wrong with them is said before anything is loaded
    _ = (
        *(
            (request.glider_places, request.goals_of_gliders)
            if request.glider
            else (request.start_place, request.goals)
        ),
        request.start_time_ns,
        request.arrive_by_s(request.start_time_ns or 0),
    )
    refusals = _mission_refusals(request) + _glider_refusals(request)
    if message := next((message for refused, message in refusals if refused), None):
        raise ConfigError(message)
    if request.risk is not None and not 0.0 <= request.risk < 1.0:
        raise ConfigError(f"--risk: expected a share from 0 to below 1, got {request.risk:g}")
    if not 0.0 <= request.arrive <= 1.0:
        raise ConfigError(f"--arrive: expected a share from 0 to 1, got {request.arrive:g}")
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


def _mission_refusals(request: PlanRequest) -> tuple[tuple[Any, str], ...]:
    moored = request.mooring is not None
    compares = bool(request.departures_ns)
    horizon = request.horizon
    shaped = moored or request.line
    return (
        (
            request.waypoint_tolerance is not None and not request.waypoints,
            "--waypoint-tolerance: expected --waypoints too",
        ),
        (
            request.surfacings_only and not moored,
            "--surfacings-only: expected --mooring too; only a mooring counts surfacings",
        ),
        (
            request.line_weight is not None and not request.line,
            "--line-weight: expected --line too",
        ),
        (
            request.line_width is not None and not request.line,
            "--line-width: expected --line too",
        ),
        (
            request.objective is not None and moored,
            "--objective: a mooring has none but to stay near its place; leave it out",
        ),
        (moored and request.line, "--mooring and --line: a mission is one or the other"),
        (
            shaped and (len(request.goal) > 1 or request.risk is not None),
            "--mooring and --line: expected one --goal and no --risk",
        ),
        (
            request.waypoints and moored,
            "--waypoints: a mooring has none on its way; give the glider the mooring's place",
        ),
        (
            compares and request.start_time is not None,
            "--depart and --start-time: expected one of them; leave out the other",
        ),
        (
            compares and request.risk is not None,
            "--depart and --risk: compare departures first, then plan the best with --start-time",
        ),
        (
            compares and horizon is not None,
            "--depart and --horizon: departures are compared by whole missions; leave out one",
        ),
        (
            shaped and (compares or horizon is not None),
            "--mooring and --line: expected no --depart and no --horizon",
        ),
        (
            request.arrive_by is not None and (moored or compares or horizon is not None),
            "--arrive-by: expected one departure to goals, without --mooring, --depart and --horizon",
        ),
        (
            request.objective == "odds" and (shaped or compares or request.risk is not None),
            "--objective odds: expected a mission to goals, without --line, --depart and --risk",
        ),
        (
            horizon is not None and request.waypoints,
            "--horizon: expected no --waypoints; they lead to the goal",
        ),
    )


def _glider_refusals(request: PlanRequest) -> tuple[tuple[Any, str], ...]:
    if not request.glider:
        return ((request.separation is not None, "--separation: expected --glider too"),)
    alone = ("start", "depart", "horizon", "mooring", "line", "risk", "arrive_by")
    given = [f"--{name.replace('_', '-')}" for name in alone if getattr(request, name)]
    named = [name for name, _ in request.goals_of_gliders if name]
    unknown = [name for name in named if name not in request.glider_places]
    return (
        (len(request.glider) < 2, "--glider: expected two gliders or more; one has --start"),
        (given, f"{', '.join(given)}: cannot be combined with --glider; plan each glider alone"),
        (
            request.objective == "odds",
            "--objective odds: cannot be combined with --glider; plan each glider alone",
        ),
        (
            unknown or len(set(named)) < len(named),
            f"--goal: expected one for a glider of --glider, got {', '.join(unknown or named)}",
        ),
    )


def check_samples(request: PlanRequest, count: int, knows_errors: bool) -> None:
    """Raise an error when odds are asked for that the samples, of which there are ``count``, do not show.

    Args:
        request: What is asked for.
        count: Number of samples.
        knows_errors: Whether the estimate states its uncertainty.

    Raises:
        ConfigError: There are none.
        PlanError: They are all the same.
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
    """Return an objective by its name, or weights such as ``time=1,energy=0.02,closest=5``.

    Raises:
        ConfigError: It is neither.
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


def mooring_of(request: PlanRequest) -> "Mooring | None":
    """Return the mooring that is asked for; None for another mission."""
    from planners.request import Mooring

    if (numbers := request.mooring_numbers) is None:
        return None
    radius, hours = numbers
    return Mooring(radius, 3600.0 * hours, request.surfacings_only)


def line_of(request: PlanRequest) -> "Line | None":
    """Return the line that a checked request follows; None where none is."""
    from planners.request import Line

    weight, width = request.line_weight, request.line_width
    return None if weight is None or width is None else Line(weight=weight, width=width)
