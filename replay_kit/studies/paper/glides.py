"""Table III: glides planned on each flow and flown in the truth, towards targets that the truth can reach."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.plan import Place, Plan
from replay_kit.studies.paper.rows import GlideRow
from replay_kit.studies.scoring.bootstrap import bootstrap_median
from replay_kit.studies.twins.reachable import Pair

PlanGlide = Callable[[FlowEstimate, Place, Place], Plan]
FlyGlide = Callable[[FlowEstimate, Plan], tuple[Array, Array, float]]

NEAR = 250.0  # m, a target passed this close counts as reached


@dataclass(frozen=True, slots=True, eq=False)
class Glides:
    """What came of planning on one flow.

    Attributes:
        row: Its figures.
        tracks: Pair by pair, shape (n, 3) [m], the path flown in the truth: east, north, depth in the truth's local frame.
    """

    row: GlideRow
    tracks: tuple[Array, ...]


def run_glides(
    flow_names: Mapping[str, FlowEstimate | None],
    truth: FlowEstimate,
    pairs: tuple[Pair, ...],
    calls: tuple[PlanGlide, FlyGlide],
    advance: Callable[[str, int], None],
) -> tuple[Glides, ...]:
    """Return how close to the targets the plans of each flow pass, in the flows' order.

    Args:
        flow_names: Flows to plan on; None where an estimate failed.
        truth: What the plans are flown in.
        pairs: Starts and targets.
        calls: The planner, and what flies its plans.
        advance: Called with what is being run, and 1, after each plan.
    """
    return tuple(_glides_on(name, flow, truth, pairs, calls, advance) for name, flow in flow_names.items())


def _glides_on(
    name: str,
    flow: FlowEstimate | None,
    truth: FlowEstimate,
    pairs: tuple[Pair, ...],
    calls: tuple[PlanGlide, FlyGlide],
    advance: Callable[[str, int], None],
) -> Glides:
    nothing = float("nan")
    if flow is None:
        advance(f"Table III {name}", len(pairs))
        row = GlideRow(name, 0, nothing, nothing, nothing, nothing, nothing, 0, 0.0, (), "there is no estimate to plan on")
        return Glides(row, ())
    began = time.perf_counter()
    plan, fly = calls
    tracks, distances = [], []
    for pair in pairs:
        _, track, distance = fly(truth, plan(flow, pair.start, pair.target))
        tracks.append(track)
        distances.append(distance)
        advance(f"Table III {name}", 1)
    quarters = np.quantile(distances, [0.25, 0.5, 0.75])
    low, high = bootstrap_median(np.array(distances))
    within = int(np.sum(np.array(distances) <= NEAR))
    seconds = time.perf_counter() - began
    row = GlideRow(
        flow=name,
        pairs=len(pairs),
        median=float(quarters[1]),
        lower_quartile=float(quarters[0]),
        upper_quartile=float(quarters[2]),
        median_low=low,
        median_high=high,
        within_250=within,
        seconds=seconds,
        closest_approach=tuple(distances),
        note="",
    )
    return Glides(row, tuple(tracks))
