"""Glides of constant velocity, planned on each flow and flown in the truth (Table III), over many truths."""

import time

import numpy as np

from replay_kit.studies.paper.diagnostics import coherence
from replay_kit.studies.planning.misses import Flown, order_of, pictures_of, place_of_average, place_of_mean, tables_of
from replay_kit.studies.planning.told import Told
from replay_kit.studies.planning.world import LABELS, World
from replay_kit.studies.twins.reachable import TARGET_DEPTH, draw_pairs

NAME = "glides"


def glides(world: World) -> Told:
    """Return what comes of glides to targets that the truth reaches."""
    flown, coherent = [], []
    for withheld, count in zip(world.truths, world.shares(world.job.pairs), strict=True):
        if count == 0:
            continue
        pairs = draw_pairs(withheld.field, withheld.truth, withheld.case.ensemble.grid, count, world.job.seed)
        depth = pairs[0].target.depth
        coherent.append(coherence(withheld.truth, depth))
        for name, flow in withheld.flows(depth).items():
            error = withheld.relative_error(flow, depth)
            for pair in pairs:
                world.say(f"glides, truth {withheld.member}, {LABELS[name]}", 1)
                began = time.perf_counter()
                plan = world.calls.plan(flow, pair.start, pair.target)
                seconds = time.perf_counter() - began
                miss = world.calls.fly(withheld.truth, plan)[2]
                said = (plan.status, plan.closest_approach, miss, error, seconds)
                flown.append(Flown(name, withheld.member, pair.start, pair.target, *said))
    depth = min(TARGET_DEPTH, flown[0].goal.depth)
    title = f"Closest approach to a target at {depth:g} m of a glide of constant velocity, planned on each flow, flown in the truth"
    return Told(
        NAME,
        "Glides of constant velocity",
        tables_of(NAME, title, flown),
        order_of(flown),
        (place_of_average(flown, float(np.mean(coherent)), once=True), place_of_mean(flown)),
        pictures_of(NAME, flown),
    )
