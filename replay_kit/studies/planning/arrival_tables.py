"""Miss distances at arrival of plans made on each flow: rows, their order, and the reasons for it."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.plan import Place
from replay_kit.studies.reports.flows import AVERAGED, FLOW_STYLES, LABELS, TRUTH
from replay_kit.studies.reports.tables import Cell, Criterion, Table, grouped, named_columns
from replay_kit.studies.scoring import bootstrap_ratio, miss_figures


@dataclass(frozen=True, slots=True)
class Arrival:
    """One plan, flown in the truth.

    Attributes:
        flow: What it was made on.
        member: The truth.
        start: Where it begins.
        goal: Where it should end.
        status: Of the plan.
        predicted: Its predicted miss distance [m].
        miss: Its miss distance in the truth [m].
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


def misses_of(arrivals: Sequence[Arrival], flow: str) -> Array:
    """Return the miss distances of the plans on a flow [m], case by case."""
    return np.array([one.miss for one in arrivals if one.flow == flow])


def tables_of(study: str, title: str, arrivals: Sequence[Arrival]) -> tuple[Table, ...]:
    """Return the figures of each flow, those of each truth, and each plan."""
    by_truth: list[dict[str, Cell]] = []
    for (member, flow), alike in grouped(arrivals, lambda one: (one.member, one.flow)).items():
        figures: dict[str, Cell] = {
            "relative error": alike[0].rel_error,
            "cases": len(alike),
            "median [m]": float(np.median([one.miss for one in alike])),
        }
        by_truth.append({"truth": member, "planned on": LABELS[flow], **figures})
    return (
        named_columns(
            study,
            title,
            [_summary(*alike) for alike in grouped(arrivals, lambda one: one.flow).items()],
        ),
        named_columns(f"{study}_by_truth", "Each truth", by_truth, shown=False),
        named_columns(f"{study}_cases", "Each plan", [_case(one) for one in arrivals], shown=False),
    )


def _summary(flow: str, alike: Sequence[Arrival]) -> dict[str, Cell]:
    figures = miss_figures(np.array([one.miss for one in alike]))
    return {
        "planned on": LABELS[flow],
        "cases": len(alike),
        "median [m]": figures["median"],
        "low [m]": figures["median_low"],
        "high [m]": figures["median_high"],
        "lower quartile [m]": figures["lower_quartile"],
        "upper quartile [m]": figures["upper_quartile"],
        "within 250 m": figures["within_250"],
        "relative error": float(np.median([one.rel_error for one in alike])),
        "reported as reached": sum(one.status == "reached" for one in alike),
        "seconds a plan": float(np.median([one.seconds for one in alike])),
    }


def _case(one: Arrival) -> dict[str, Cell]:
    return {
        "planned on": LABELS[one.flow],
        "truth": one.member,
        "start longitude": one.start.longitude,
        "start latitude": one.start.latitude,
        "goal longitude": one.goal.longitude,
        "goal latitude": one.goal.latitude,
        "goal depth [m]": one.goal.depth,
        "status": one.status,
        "predicted [m]": one.predicted,
        "miss [m]": one.miss,
        "seconds": one.seconds,
    }


def order_of(arrivals: Sequence[Arrival]) -> tuple[Criterion, ...]:
    """Return the order that is expected, as ratios of medians: truth, default, naive 3D basis, nearest member."""
    order = (TRUTH, "default", "naive3d", "nearest")
    return tuple(_criterion(arrivals, before, after) for before, after in pairwise(order))


def _criterion(arrivals: Sequence[Arrival], above: str, below: str) -> Criterion:
    ratio, low, high = _ratio(arrivals, above, below)
    return Criterion(
        f"median on the {LABELS[above]} over that on the {LABELS[below]}",
        ratio,
        at_most=1.0,
        low=low,
        high=high,
    )


def _ratio(arrivals: Sequence[Arrival], above: str, below: str) -> tuple[float, float, float]:
    """Return the ratio of the median miss distances on two flows, and its 90 % interval."""
    values, others = misses_of(arrivals, above), misses_of(arrivals, below)
    return float(np.median(values) / np.median(others)), *bootstrap_ratio(values, others)


def _median(arrivals: Sequence[Arrival], flow: str) -> float:
    return float(np.median(misses_of(arrivals, flow)))


def place_of_mean(arrivals: Sequence[Arrival]) -> str:
    """Return how plans on the ensemble mean compare with the others, in words."""
    ratio, low, high = _ratio(arrivals, "ensemble_mean", "nearest")
    return (
        f"Plans on the ensemble mean, which uses no ping, miss by a median of {_median(arrivals, 'ensemble_mean'):.0f} m: {ratio:.2f} "
        f"times that of the nearest member (90 % interval {low:.2f} to {high:.2f}). The mean is not part of the expected order."
    )


def place_of_average(arrivals: Sequence[Arrival], coherence: float, once: bool) -> str:
    """Return how plans on the depth-averaged truth compare with those on the default estimate and why, in words.

    Args:
        arrivals: Each plan.
        coherence: Share of the truths' mean squared speed that the depth average carries.
        once: Whether each depth is passed once, as by a glide, or many times, as by dives.
    """
    ratio, low, high = _ratio(arrivals, AVERAGED, "default")
    average, default = (
        np.median([one.rel_error for one in arrivals if one.flow == flow])
        for flow in (AVERAGED, "default")
    )
    why = (
        "A glide at one vertical speed spends the same time at every depth, so the average gives the whole drift of a current that does "
        "not change along the path. It does not resolve that the glide meets the upper current in one place and the lower one in another."
        if once
        else "Every dive passes all depths evenly within a few kilometres, so the average gives nearly the whole drift of each dive."
    )
    return (
        f"Plans on the depth-averaged truth miss by a median of {_median(arrivals, AVERAGED):.0f} m, those on the default estimate by "
        f"{_median(arrivals, 'default'):.0f} m: a ratio of {ratio:.2g} (90 % interval {low:.2g} to {high:.2g}). Their relative errors are "
        f"{average:.2f} and {default:.2f}; the average carries {100.0 * coherence:.0f} % of the truths' mean squared speed. {why} "
        "The average is computed from the truth, which an estimate has to infer; it is reported for comparison, without a criterion."
    )


# Miss distances and errors below these are drawn at these.
_LEAST_MISS, _LEAST_ERROR = 1.0, 1e-3


def draw_misses(arrivals: Sequence[Arrival], figure: Any) -> None:
    """Draw the distribution of miss distances, and each truth's median against the error of the flow that plans were made on."""
    left, right = figure.subplots(1, 2)
    for flow, alike in grouped(arrivals, lambda one: one.flow).items():
        style = FLOW_STYLES[flow]
        of_flow = {"color": style.colour, "label": style.label}
        misses = np.sort(np.maximum([one.miss for one in alike], _LEAST_MISS))
        left.step(
            np.append(misses[:1], misses),
            np.arange(misses.size + 1) / misses.size,
            where="post",
            **of_flow,
        )
        of_truth = grouped(alike, lambda one: one.member).values()
        errors = [max(of[0].rel_error, _LEAST_ERROR) for of in of_truth]
        medians = [max(float(np.median([one.miss for one in of])), _LEAST_MISS) for of in of_truth]
        right.scatter(errors, medians, s=28, marker=style.marker, **of_flow)
    left.set(
        xscale="log",
        xlabel="miss distance in the truth [m]",
        ylabel="share of the plans",
        ylim=(0.0, 1.0),
    )
    right.set(
        xscale="log",
        yscale="log",
        xlabel="relative error of the flow",
        ylabel="median miss distance of a truth [m]",
    )
    # within one decade the labels of its parts would overlap
    right.set_xlim(min(right.get_xlim()[0], 1e-2), max(right.get_xlim()[1], 1.5))
    for axes in (left, right):
        axes.grid(alpha=0.3)
        axes.tick_params(which="minor", labelbottom=False)
    figure.legend(
        *left.get_legend_handles_labels(), loc="outside lower center", ncols=6, fontsize=10
    )
