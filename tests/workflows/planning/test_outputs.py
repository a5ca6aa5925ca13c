"""What is said of a mission: whether it may be handed to a vehicle, and its energy."""

from types import SimpleNamespace

import pytest

from replay_kit.config.plan import PlanRequest
from replay_kit.workflows.planning.outputs import unsafe_reason

SAFE, CROSSING = (SimpleNamespace(violation=violation) for violation in (None, "crosses land"))


NO_OTHER = "no other tolerance tried is, a larger --margin may be"


@pytest.mark.parametrize(
    ("waypoints", "status", "risk", "safe", "why"),
    [
        (None, "reached", None, None, None),
        (None, "unsafe", None, None, None),
        (SAFE, "reached", None, None, None),
        (SAFE, "unsafe", None, None, "waypoints of an unsafe plan"),
        (CROSSING, "reached", 0.1, 1.0, f"the waypoints are not safe; {NO_OTHER}"),
        (SAFE, "reached", 0.1, 0.9, None),
        (
            SAFE,
            "reached",
            None,
            0.8,
            f"the waypoints are not safe in 20 % of the samples; {NO_OTHER}",
        ),
        (SAFE, "reached", 0.3, 0.8, None),
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
    odds = SimpleNamespace(safe=safe, violations={"land": 0.05, "banks": 0.15})
    planned = SimpleNamespace(
        **{"waypoints": waypoints, "odds": None if safe is None else odds, "helps": None},
        **{"plan": SimpleNamespace(status=status), "job": PlanRequest(risk=risk)},
    )
    assert unsafe_reason(planned) == why
