"""Missions of many dives, planned on each flow and flown in the truth without any correction on the way."""

import time

import numpy as np

from replay_kit.core.geodesy import distance
from replay_kit.studies.paper.diagnostics import coherence
from replay_kit.studies.planning.flights import ANGLES, draw_missions
from replay_kit.studies.planning.misses import NEAR, Flown, order_of, pictures_of, place_of_average, place_of_mean, tables_of
from replay_kit.studies.planning.told import Told
from replay_kit.studies.planning.world import LABELS, World
from replay_kit.studies.twins.reachable import SPEED

NAME = "missions"


def missions(world: World) -> Told:
    """Return what comes of missions to goals that missions of random headings reach in the truth."""
    flown, coherent = [], []
    vehicle = world.calls.glider(SPEED, *ANGLES)
    settings = world.calls.settings(depth=world.depth, legs=world.job.legs, tolerance=NEAR)
    for withheld, count in zip(world.truths, world.shares(world.job.pairs), strict=True):
        if count == 0:
            continue
        pairs = draw_missions(withheld, withheld.truth, count, world.depth, world.job.legs, world.job.seed)
        coherent.append(coherence(withheld.truth, world.depth))
        for name, flow in withheld.flows(world.depth).items():
            error = withheld.relative_error(flow, world.depth)
            for pair in pairs:
                world.say(f"missions, truth {withheld.member}, {LABELS[name]}", 1)
                began = time.perf_counter()
                plan = world.calls.plan_mission(flow, pair.start, pair.target, vehicle=vehicle, settings=settings)
                seconds = time.perf_counter() - began
                if len(plan.headings_deg):
                    miss, predicted = float(world.calls.fly_mission(withheld.truth, plan).miss[0, -1]), float(plan.closest_approach[-1])
                else:
                    # a plan that failed stays where it is
                    ends = pair.start.longitude, pair.start.latitude, pair.target.longitude, pair.target.latitude
                    miss, predicted = float(distance(*ends)), float("nan")
                flown.append(Flown(name, withheld.member, pair.start, pair.target, plan.status, predicted, miss, error, seconds))
    dives = f"{world.job.legs} dives to {world.depth:g} m, a heading and glide angle each"
    title = f"Miss of the goal by {dives}, planned on each flow, flown in the truth"
    return Told(
        NAME,
        "Missions of many dives",
        tables_of(NAME, title, flown),
        order_of(flown),
        (place_of_average(flown, float(np.mean(coherent)), once=False), place_of_mean(flown)),
        pictures_of(NAME, flown),
    )
