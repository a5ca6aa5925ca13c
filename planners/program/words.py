"""Text on a plan: outcome with the binding limit, odds, and truncation at a horizon."""

from collections.abc import Mapping

import numpy as np

from planners.program.solution import Solution, deviation, lacking_energy, overtime
from planners.program.starts import Answer
from planners.request import Line, MissionPlan, Mooring
from planners.task import Task
from replay_kit.core.plan import share_interval
from replay_kit.core.words.text import place_text, time_text

# A mission this close to the longest one considered is limited by it.
_NEARLY = 0.95


def tried_text(found: Solution) -> str:
    """Return the outcome of a solution as text for the statistics."""
    safe = "" if found.violation is None else f", crosses {found.violation.what}"
    name = "" if found.start is None else f"{found.start.name}, "
    return f"{name}{found.count} legs: {found.seconds / 3600.0:.2f} h, {found.miss.max():.0f} m off{safe}, {found.solved.status}"


def outcome_text(task: Task, answer: Answer, above: float | None) -> str:
    """Return the outcome of a mission as text, with the binding limit if goals are missed or constraints violated.

    Args:
        task: Mission.
        answer: Result of the search.
        above: Relative excess of the arrival time over its lower bound [%]; None if unknown.
    """
    settings, shape, best = task.settings, task.shape, answer.best
    miss, flight = best.miss, best.flight
    if not best.count:
        return _already_there(task)
    parts, short = list[str](), ""
    if not isinstance(shape, Mooring):
        names = ["the goal"] if len(miss) == 1 else [f"goal {k + 1}" for k in range(len(miss))]
        verbs = [
            "meets {} at" if distance <= settings.tolerance else "misses {} by" for distance in miss
        ]
        times = flight.time[0, best.points]
        parts += [
            f"{verb.format(name)} {distance:.1f} m after {_hours(task, float(time))}"
            for verb, name, distance, time in zip(verbs, names, miss, times, strict=True)
        ]
        if np.any(miss > settings.tolerance):
            short = f", outside the tolerance of {settings.tolerance:g} m"
    if shape is not None:
        farthest, rms = deviation(task, best)
        limit, name = (
            (shape.width, "the line") if isinstance(shape, Line) else (shape.radius, "the mooring")
        )
        parts.append(
            f"{farthest:.0f} m from {name} at most, {rms:.0f} m RMS, for {_hours(task, best.seconds)}"
        )
        short += "" if farthest <= limit else f", farther than {limit:g} m"
    if above is not None:
        parts.append(f"{above:.1f} % above the lower bound of the arrival time at this speed")
    n_legs = best.count
    text = f"{n_legs} leg{'s' * (n_legs != 1)}; {', '.join(parts)}"
    if best.violation is not None:
        at = best.violation
        text += f"; not safe: crosses {at.what} at {at.longitude:.4f}, {at.latitude:.4f} in leg {at.leg} after {_hours(task, at.time)}"
    if (lacking := lacking_energy(task, best)) > 0.0:
        needed, held = (lacking + settings.battery) / 1e6, settings.battery / 1e6
        text += f"; limit: the battery: it takes {needed:.3g} MJ of {held:.3g} MJ (--battery)"
    # of a mission that misses its goals it is among what binds
    if overtime(task, best) > 0.0 and not short:
        text += f"; {_longest_text(task)}"
    if task.is_late:
        text += f"; the time limit of {settings.time_limit:g} s ended the search: other numbers of legs and routes were not tried"
    return (
        f"{text}{short}{_out_of_reach(task, answer)}; {_binding(task, answer)}" if short else text
    )


def _already_there(task: Task) -> str:
    """Return the reason for a mission without legs as text."""
    name = "the goal" if len(task.goals) == 1 else "all goals"
    below = float(np.max(task.goals[:, 2] - task.start[2]))
    deep = "" if below <= 0.0 else f"; a goal is {below:g} m below the start"
    within = f"within {np.max(task.from_start):.1f} m of {name}, inside the tolerance of {task.settings.tolerance:g} m"
    return f"already there: the start is {within}; 0 legs{deep}"


def _out_of_reach(task: Task, answer: Answer) -> str:
    """Return the goals out of reach, with their closest approach, as text; empty without any."""
    text = ""
    for bound in answer.beyond:
        text += f"; {'the goal' if len(task.goals) == 1 else f'goal {bound.goal + 1}'} is out of reach: "
        if bound.limit == "legs":
            text += f"it needs more than {task.settings.legs or task.settings.max_legs} legs"
            continue
        who = (
            "no vehicle of this speed comes" if bound.is_tight else "no route was found that comes"
        )
        nearest, when = f" than about {bound.nearest / 1e3:.1f} km", _hours(task, bound.when)
        # what a plan's own legs pass may be nearer than routes on a lattice
        beyond = answer.best.miss[bound.goal] < bound.nearest
        after = "" if beyond else f"{nearest}, after {when}"
        text += f"within {_hours(task, bound.most)} {who} nearer{after}"
    return text


def _hours(task: Task, seconds: float) -> str:
    """Return a time since the start in hours and, if the mission has a date, as a date."""
    return _since(task.request.start_time_ns, seconds)


def _since(begins: int, seconds: float) -> str:
    """Return a time since a start [ns, UTC; 0 if unknown] in hours and as a date."""
    return f"{seconds / 3600.0:.1f} h" + (
        f" ({time_text(begins + round(seconds * 1e9))})" if begins else ""
    )


def _binding(task: Task, answer: Answer) -> str:
    """Return the binding limits as text."""
    settings = task.settings
    flight, lasts = answer.best.flight, answer.best.seconds
    tried = max((one.count for one in answer.tried), default=0)
    limits = {bound.limit for bound in answer.beyond}
    parts = list[str]()
    if settings.weights.closest:
        return "limit: the weights (coming closer costs more than it gains) or the vehicle's range"
    if settings.legs is not None and task.shape is None:
        return f"limit: {settings.legs} legs at glide angles from {task.vehicle.min_angle:g} to {task.vehicle.max_angle:g} degrees"
    if "legs" in limits or (not limits and tried >= settings.most_legs):
        parts.append(f"limit: max_legs = {settings.max_legs} (--max-legs)")
    if "duration" in limits or (not limits and lasts >= _NEARLY * settings.max_duration):
        parts.append(_longest_text(task))
    if "ways" in limits:
        parts.append(
            "a constraint closes every route: land, an area, water too shallow for a dive or the edge of the region"
        )
    if parts and "current" not in limits:
        return "; ".join(parts)
    ground = float(np.linalg.norm(flight.place[0, -1] - flight.place[0, 0])) / max(lasts, 1.0)
    through = float(task.vehicle.speeds(np, task.vehicle.angles[0])[0])
    what = "the current" if "current" in limits else "the current or a constraint"
    return "; ".join(
        [*parts, f"{what} stops a glider of {through:.2f} m/s: {ground:.2f} m/s over ground"]
    )


def _longest_text(task: Task) -> str:
    """Return the limit of a mission's duration as text."""
    settings = task.settings
    if settings.arrive_by <= settings.max_duration:
        return f"limit: {settings.arrive_by / 3600.0:.1f} h until the latest arrival (--arrive-by)"
    return f"limit: max_duration = {settings.max_duration:g} s (--max-duration)"


def odds_text(
    plan: MissionPlan, count: int, reached: float, radius: float, deadline: float, to: str = ""
) -> str:
    """Return the odds of arriving as text; ``to`` names what the flights head for, if not the legs."""
    text = f"{round(reached * count)} of {count} simulated flights{to}"
    low, high = share_interval(reached, count)
    share = f"{100.0 * reached:.0f} %, 90 % interval {100.0 * low:.0f} to {100.0 * high:.0f} %"
    if plan.is_moored:
        return f"{text} stay within {radius:g} m ({share})"
    where = "where the plan ends" if plan.status == "partial" else "the goal"
    if len(plan.goals) > 1:
        where = "each goal"
    return f"{text} come up within {radius:g} m of {where} by {_since(plan.start_time_ns, deadline)} ({share})"


def arrival_text(plan: MissionPlan, median: float, ninety: float) -> str:
    """Return the text on median and 90 % arrival times [s since the start]; empty if fewer arrive."""
    text = f"; half arrive by {_since(plan.start_time_ns, median)}" if np.isfinite(median) else ""
    return text + (f", 90 % by {_since(plan.start_time_ns, ninety)}" if np.isfinite(ninety) else "")


def violations_text(violating: float, violations: Mapping[str, float]) -> str:
    """Return the text on the fraction of violating samples, by constraint; empty without any."""
    if not violations:
        return ""
    named = ", ".join(
        f"{name} {100.0 * part:.0f} %"
        for name, part in sorted(violations.items(), key=lambda one: -one[1])
    )
    return f"; {100.0 * violating:.0f} % violate a constraint ({named})"


def horizon_text(plan: MissionPlan, cut: MissionPlan, seconds: float, unmet: int) -> str:
    """Return the text on a plan truncated at a horizon, and its remainder.

    Args:
        plan: Complete plan.
        cut: Truncated plan.
        seconds: Horizon [s].
        unmet: Number of the first remaining goal, from 0.
    """
    name = "the goal" if len(plan.goals) == 1 else f"goal {unmet + 1}"
    left, hours = float(cut.closest_approach[unmet]), (plan.duration - cut.duration) / 3600.0
    return (
        f"up to the horizon of {seconds / 3600.0:.1f} h: {len(cut.headings_deg)} of {len(plan.headings_deg)} legs, after "
        f"{cut.duration / 3600.0:.1f} h at {place_text(*cut.surfacings[-1].tolist())}; {left / 1e3:.1f} km left to {name}, and "
        f"{hours:.1f} h to the end in the last known current"
    )
