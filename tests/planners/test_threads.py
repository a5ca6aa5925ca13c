"""Plans made by several threads of a process are those made one after the other."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np

from planners import MissionSettings, plan_mission
from tests.planners.flow_samples import eddying_flow, place, request_between

FLOW = eddying_flow(3, speed=0.1)
SETTINGS = MissionSettings(depth=300.0, surface_time=300.0)


def test_missions_planned_by_two_threads_are_those_planned_in_turn():
    first = request_between(FLOW, (-5e3, 0.0), (3e3, 1e3), settings=SETTINGS)
    asked = [replace(first, goals=(place(FLOW, 3e3, north),)) for north in (1e3, -1e3, 2e3, -2e3)]
    in_turn = [plan_mission(FLOW, request) for request in asked]
    with ThreadPoolExecutor(2) as threads:
        together = list(threads.map(lambda request: plan_mission(FLOW, request), asked))
    for one, other in zip(in_turn, together, strict=True):
        np.testing.assert_array_equal(one.track, other.track)
