"""What is said of a mission: whether it may be handed to a vehicle, and its energy."""

import io
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from planners import MissionSettings, Mooring
from planners.flights import surfacing_ellipses
from replay_kit.config.plan import PlanRequest
from replay_kit.core.grid import Projection
from replay_kit.show.text import SafeConsole
from replay_kit.workflows.planning.outputs import print_mission, unsafe_reason
from tests.planners.flow_samples import plan_between, still_flow

SAFE, CROSSING = (
    SimpleNamespace(violation=violation, risk=None) for violation in (None, "crosses land")
)
RISKY = SimpleNamespace(violation=None, risk=SimpleNamespace(violating=0.2))


@pytest.mark.parametrize(
    ("waypoints", "status", "risk", "safe", "why"),
    [
        (None, "reached", None, None, None),
        (None, "unsafe", None, None, None),
        (SAFE, "reached", None, None, None),
        (SAFE, "unsafe", None, None, "waypoints of a plan that is not safe"),
        (CROSSING, "reached", 0.1, 1.0, "the waypoints are not safe"),
        (SAFE, "reached", 0.1, 0.9, None),
        (RISKY, "reached", None, 1.0, "the waypoints are not safe in 20 % of the samples"),
        (RISKY, "reached", 0.3, 1.0, None),
        (
            SAFE,
            "reached",
            0.1,
            0.85,
            "the risk of 10 % cannot be kept: the least found is 15 %, from banks 15 %, land 5 %",
        ),
        (
            None,
            "unsafe",
            0.1,
            0.95,
            "the risk of 10 % cannot be kept: the least found is 5 %, from banks 15 %, land 5 %",
        ),
        (None, "unsafe", 0.1, None, None),
    ],
)
def test_a_mission_is_handed_over_where_it_is_safe_or_no_one_asked(
    waypoints, status, risk, safe, why
):
    samples = None if safe is None else {"safe": safe, "violations": {"land": 0.05, "banks": 0.15}}
    planned = SimpleNamespace(
        waypoints=waypoints, samples=samples, plan=SimpleNamespace(status=status)
    )
    assert unsafe_reason(planned, PlanRequest(risk=risk)) == why


@pytest.mark.parametrize(
    ("shape", "words"), [(None, "miss"), (Mooring(1e3, 1e4), "farthest from the mooring")]
)
def test_the_samples_of_a_mooring_are_told_by_how_far_they_drift(shape, words):
    settings = MissionSettings(depth=300.0)
    plan = plan_between(still_flow(), (0.0, 0.0, 0.0), (3e3, 0.0), settings=settings)
    figures = ("miss_median_m", "miss_90_percent_m", "miss_90_percent_held_m")
    planned = SimpleNamespace(
        plan=replace(plan, shape=shape),
        samples=dict.fromkeys(figures, 70.0),
        **dict.fromkeys(("departures", "notes"), ()),
        waypoints=None,
    )
    said = io.StringIO()
    print_mission(planned, SafeConsole(file=said, width=200))
    assert f"in the samples: {words} in the median 70 m, 90 % within 70 m" in said.getvalue()


def test_an_ellipse_of_few_surfacings_has_the_variance_of_a_sample():
    """Of 1, 2 and 6 km east, and as far north, it is 7 km^2; Hotelling's factor of three is the root of 264."""
    place = 1e3 * np.array([1.0, 2.0, 6.0])[:, None, None] * np.ones(2)
    flights = SimpleNamespace(place=place, time=np.zeros(1), projection=Projection(5.0, 62.0))
    plan = SimpleNamespace(surfacing_times=np.zeros(1))
    ((_, _, major, minor, _),) = surfacing_ellipses(flights, plan)
    assert (major, minor) == pytest.approx((np.sqrt(264.0 * 14.0) * 1e3, 0.0), abs=0.1)
