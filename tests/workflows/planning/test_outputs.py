"""What is said of a mission: whether it may be handed to a vehicle, and its energy."""

from types import SimpleNamespace

import pytest

from replay_kit.config.plan import PlanRequest
from replay_kit.workflows.planning.outputs import unsafe_reason

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
        waypoints=waypoints, samples=samples, plan=SimpleNamespace(status=status), policy=None
    )
    assert unsafe_reason(planned, PlanRequest(risk=risk)) == why
    planned.waypoints, planned.policy = None, RISKY
    risky = unsafe_reason(planned, PlanRequest())
    assert risky == "the policy is not safe in 20 % of the samples"
