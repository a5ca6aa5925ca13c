"""What small results hold, made by hand."""

from dataclasses import replace
from typing import Any

import numpy as np

from replay_kit.core.grid import Projection
from replay_kit.core.plan import Odds, Place, Plan
from replay_kit.results.innovations import Columns, block_of, columns_of
from replay_kit.results.mcap.schemas import decode, encode
from replay_kit.results.outcome.outcome import Outcome
from replay_kit.show.status.held import Fix, Held
from tests.results.conftest import INNOVATION, PLAN

HOUR_NS = 3_600 * 10**9
START_NS = 1_700_000_000 * 10**9
_ELLIPSE = {"ellipse_major_m": 2000.0, "ellipse_minor_m": 500.0, "ellipse_bearing_deg": 30.0}


def plan(time_ns: int, **values: Any) -> Plan:
    """A mission of two legs of four hours, with ellipses."""
    legs = []
    for k in range(2):
        place = {"longitude": 5.1 + 0.1 * k, "latitude": 62.0}
        when = {"leg": k + 1, "start_s": 14_400.0 * k, "surfacing_s": 14_400.0 * (k + 1)}
        steer = {"heading_deg": values.pop(f"heading_{k + 1}", 80.0), "glide_angle_deg": 20.0}
        centre = {f"ellipse_{name}": value for name, value in place.items()}
        legs.append({**when, **steer, "depth_m": 500.0, **place, **centre, **_ELLIPSE})
    made = replace(
        PLAN,
        **{"message": "meets the goal", "start_time_ns": time_ns, "heading_deg": 80.0},
        **{"goal": Place(5.5, 62.0, 100.0), "duration": 28_800.0, "closest_approach": 12.0},
        **{"legs": tuple(legs), "energy": 250_000.0, "battery": 1_000_000.0, "statistics": {}},
        odds=Odds(10, 0.9, 1.0, 250.0, 9e4, 7e4, 8e4),
    )
    return replace(made, **values)


def outcome(time_ns: int, planned_ns: int, *, inside: bool = True) -> Any:
    times = {"timestamp": time_ns, "planned_time": planned_ns}
    stamps = {
        name: dict(zip(("seconds", "nanos"), divmod(ns, 10**9), strict=True))
        for name, ns in times.items()
    }
    miss = {"distance": 3500.0, "direction_deg": 270.0, "delay": 600.0}
    about = {"inside_ellipse": inside, "ellipse_major": 2000.0}
    return decode("PlanOutcome", encode("PlanOutcome", {**stamps, **miss, **about}))


def mean_current(
    time_ns: int,
    measured: tuple[float, float],
    predicted: tuple[float, float],
    std: float,
    corrected: tuple[float, float] | None = None,
    **errors: float,
) -> Columns:
    """Return the columns of a dive of one mean current."""
    off = np.array([corrected or measured]) - np.array([predicted])
    of_bin = dict.fromkeys(("innovation", "residual", "prior_innovation"), off)
    one = replace(
        INNOVATION,
        **{"time_ns": time_ns, "dive": 7, "dof": 2, "mean_kind": "dac", "depth": np.zeros(1)},
        **{"flags": np.ones(1, np.int8), "reasons": np.zeros(1, np.int32), **of_bin},
        **{"innovation_std": np.full((1, 2), std), "mean_current": np.array(measured), **errors},
        corrected_current=None if corrected is None else np.array(corrected),
    )
    return columns_of(block_of([one]))


def held(**values: Any) -> Held:
    """A vehicle that came 18 km nearer to its goal in two days, with a plan made an hour ago."""
    end = START_NS + 48 * HOUR_NS
    times = {"first": "2023-11-14T00:00:00Z", "last": "2023-11-18T00:00:00Z", "evolves": "true"}
    given = {
        **{"name": "r.mcap", "last_ns": end, "reckoned": None},
        "metadata": {"replay_kit.forecast": times},
        "settings": {"measurements": {"fix_std": 20.0}},
        "outcome": Outcome(nis_per_dof=1.0),
        "projection": Projection(5.0, 62.0),
        "fixes": [
            Fix(START_NS, 4.65, 62.0, False),
            Fix(end - 25 * HOUR_NS, 4.9, 62.0, False),
            Fix(end, 5.0, 62.0, False),
        ],
        "plans": [plan(end - 4 * HOUR_NS, heading_2=60.0), plan(end)],
        "outcomes": [outcome(end, end - 4 * HOUR_NS)],
        "dive": mean_current(end, (0.1, 0.0), (0.0, 0.0), 0.02),
    }
    return Held(**(given | values))
