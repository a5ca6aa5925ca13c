"""Table III: glides planned on each flow and flown in the truth, towards targets that the truth can reach."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

import planners
from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.tasks import each_call
from replay_kit.studies.jobs.progress import Advance
from replay_kit.studies.paper.rows import GlideRow
from replay_kit.studies.scoring.scores import miss_figures
from replay_kit.studies.twins.reachable import Pair


@dataclass(frozen=True, slots=True, eq=False)
class Glides:
    """The outcome of planning on one flow.

    Attributes:
        row: Its figures.
        tracks: Pair by pair, shape (n, 3) [m], the path flown in the truth: east, north, depth in the truth's local frame.
    """

    row: GlideRow
    tracks: tuple[Array, ...]


def run_glides(
    flows: Mapping[str, FlowEstimate | None],
    truth: FlowEstimate,
    pairs: tuple[Pair, ...],
    advance: Advance,
) -> tuple[Glides, ...]:
    """Return how close to the targets the plans on each flow pass, in the flows' order.

    Args:
        flows: Flows to plan on; None where an estimate failed.
        truth: What the plans are flown in.
        pairs: Starts and targets.
        advance: Counts plans as steps.
    """
    before, found = advance.done, list[Glides]()
    calls = (
        (name, flow, truth, pairs, partial(advance, f"Table III {name}"))
        for name, flow in flows.items()
    )
    for glides in each_call(_glides_on, calls):
        found.append(glides)
        advance.reach(before + len(found) * len(pairs), "Table III")
    return tuple(found)


def _glides_on(
    name: str,
    flow: FlowEstimate | None,
    truth: FlowEstimate,
    pairs: tuple[Pair, ...],
    advance: Callable[[int], None],
) -> Glides:
    if flow is None:
        advance(len(pairs))
        return Glides(GlideRow(name, note="there is no estimate to plan on"), ())
    began = time.perf_counter()
    tracks, distances = [], []
    for pair in pairs:
        _, track, distance = planners.fly(truth, planners.plan(flow, pair.start, pair.target))
        tracks.append(track)
        distances.append(distance)
        advance(1)
    seconds = time.perf_counter() - began
    row = GlideRow(
        name,
        len(pairs),
        **miss_figures(np.array(distances)),
        seconds=seconds,
        closest_approach=tuple(distances),
    )
    return Glides(row, tuple(tracks))
