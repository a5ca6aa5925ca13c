"""How far plans made on each flow end from their goals in the truth: rows, order, and what the order comes from."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.plan import Place
from replay_kit.studies.planning.pictures import draw_misses
from replay_kit.studies.planning.told import Asked, Picture, Table
from replay_kit.studies.planning.world import AVERAGED, LABELS, TRUTH
from replay_kit.studies.scoring.bootstrap import bootstrap_median, bootstrap_ratio

NEAR = 250.0  # m, a goal met this closely counts as reached


_COLUMNS = (
    "planned on",
    "cases",
    "median [m]",
    "low [m]",
    "high [m]",
    "lower quartile [m]",
    "upper quartile [m]",
    "within 250 m",
    "relative error",
    "said reached",
    "seconds a plan",
)


@dataclass(frozen=True, slots=True)
class Flown:
    """One plan, flown in the truth.

    Attributes:
        flow: What it was made on.
        member: The truth.
        start: Where it begins.
        goal: Where it should end.
        status: Of the plan.
        predicted: By how much the plan says it misses [m].
        miss: By how much it misses in the truth [m].
        rel_error: Of the flow, against the truth, down to the plan's depth.
        seconds: To plan.
    """

    flow: str
    member: int
    start: Place
    goal: Place
    status: str
    predicted: float
    miss: float
    rel_error: float
    seconds: float


def misses_of(flown: Sequence[Flown], flow: str) -> Array:
    """Return how far the plans of a flow miss [m], case by case."""
    return np.array([one.miss for one in flown if one.flow == flow])


def tables_of(study: str, title: str, flown: Sequence[Flown]) -> tuple[Table, ...]:
    """Return the figures of each flow, those of each truth, and each plan."""
    flows = tuple(dict.fromkeys(one.flow for one in flown))
    by_truth = []
    for member in dict.fromkeys(one.member for one in flown):
        for flow in flows:
            alike = [one for one in flown if (one.member, one.flow) == (member, flow)]
            by_truth.append((member, LABELS[flow], alike[0].rel_error, len(alike), float(np.median([one.miss for one in alike]))))
    cases = tuple(
        (
            *(LABELS[one.flow], one.member, one.start.longitude, one.start.latitude, one.goal.longitude, one.goal.latitude),
            *(one.goal.depth, one.status, one.predicted, one.miss, one.seconds),
        )
        for one in flown
    )
    of_case = ("planned on", "truth", "start longitude", "start latitude", "goal longitude", "goal latitude", "goal depth [m]")
    return (
        Table(study, title, _COLUMNS, tuple(_row(flow, [one for one in flown if one.flow == flow]) for flow in flows)),
        Table(
            f"{study}_by_truth",
            "Each truth",
            ("truth", "planned on", "relative error", "cases", "median [m]"),
            tuple(by_truth),
            shown=False,
        ),
        Table(f"{study}_cases", "Each plan", (*of_case, "status", "predicted [m]", "miss [m]", "seconds"), cases, shown=False),
    )


def _row(flow: str, alike: Sequence[Flown]) -> tuple[str | int | float, ...]:
    miss = np.array([one.miss for one in alike])
    low, high = bootstrap_median(miss)
    quarters = (float(quarter) for quarter in np.quantile(miss, [0.25, 0.75]))
    near, said = int(np.sum(miss <= NEAR)), sum(one.status == "reached" for one in alike)
    error, seconds = (float(np.median([getattr(one, name) for one in alike])) for name in ("rel_error", "seconds"))
    return (LABELS[flow], len(alike), float(np.median(miss)), low, high, *quarters, near, error, said, seconds)


def order_of(flown: Sequence[Flown]) -> tuple[Asked, ...]:
    """Return the order that is expected, as ratios of medians: truth, default, naive 3D basis, nearest member."""
    order = (TRUTH, "default", "naive3d", "nearest")
    return tuple(_ratio(flown, before, after) for before, after in pairwise(order))


def _ratio(flown: Sequence[Flown], above: str, below: str) -> Asked:
    values, others = misses_of(flown, above), misses_of(flown, below)
    low, high = bootstrap_ratio(values, others)
    what = f"median on the {LABELS[above]} over that on the {LABELS[below]}"
    return Asked(what, float(np.median(values) / np.median(others)), at_most=1.0, low=low, high=high)


def place_of_mean(flown: Sequence[Flown]) -> str:
    """Return where the ensemble's mean stands, in words."""
    mean, nearest = misses_of(flown, "ensemble_mean"), misses_of(flown, "nearest")
    low, high = bootstrap_ratio(mean, nearest)
    ratio = float(np.median(mean) / np.median(nearest))
    return (
        f"Plans on the ensemble's mean, which has seen no ping, miss by a median of {np.median(mean):.0f} m: {ratio:.2f} times that of the "
        f"nearest member (90 % interval {low:.2f} to {high:.2f}). It is no part of the order."
    )


def place_of_average(flown: Sequence[Flown], coherence: float, once: bool) -> str:
    """Return where the depth-averaged truth stands and why, in words.

    Args:
        flown: Each plan.
        coherence: Share of the truths' mean squared speed that the depth average carries.
        once: Whether each depth is passed once, as by a glide, or many times, as by dives.
    """
    average, default = misses_of(flown, AVERAGED), misses_of(flown, "default")
    low, high = bootstrap_ratio(average, default)
    ratio = float(np.median(average) / np.median(default))
    errors = {flow: [one.rel_error for one in flown if one.flow == flow] for flow in (AVERAGED, "default")}
    why = (
        "A glide at one vertical speed spends the same time at every depth, so the average gives the whole drift of a current that does "
        "not change along the path. It misses that the upper current is met in one place and the lower one in another."
        if once
        else "Every dive passes all depths evenly within a few kilometres, so the average gives nearly the whole drift of each dive."
    )
    return (
        f"Plans on the depth-averaged truth miss by a median of {np.median(average):.0f} m, those on the default estimate by "
        f"{np.median(default):.0f} m: a ratio of {ratio:.2g} (90 % interval {low:.2g} to {high:.2g}). Their relative errors are "
        f"{np.median(errors[AVERAGED]):.2f} and {np.median(errors['default']):.2f}; the average carries {100.0 * coherence:.0f} % of the "
        f"truths' mean squared speed. {why} It knows the truth, which an estimate has to learn; its place is told, not asked for."
    )


def pictures_of(study: str, flown: Sequence[Flown]) -> tuple[Picture, ...]:
    """Return the picture of the misses: how they are spread, and how they go with the flows' errors."""
    caption = (
        "Left: share of the plans that miss by no more. Right: each truth's median against the relative error of the flow planned on; "
        "misses below 1 m are drawn there"
    )
    return (Picture(f"{study}_misses", caption, (11.0, 4.6), partial(draw_misses, tuple(flown))),)
