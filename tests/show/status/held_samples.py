"""What small results hold, made by hand."""

from dataclasses import replace
from typing import Any

import numpy as np

from replay_kit.core.grid import Projection
from replay_kit.core.observation import Innovation, Source
from replay_kit.core.plan import Odds, Place, Plan
from replay_kit.results.innovations import Columns, block_of, columns_of
from replay_kit.results.outcome.outcome import Outcome
from replay_kit.results.schemas import decode, encode
from replay_kit.show.status.held import Fix, Held

HOUR_NS = 3_600 * 10**9
START_NS = 1_700_000_000 * 10**9


def stamp(time_ns: int) -> dict[str, int]:
    return {"seconds": time_ns // 10**9, "nanos": time_ns % 10**9}


def plan(time_ns: int, **values: Any) -> Plan:
    """A mission of two legs of four hours, with ellipses."""
    legs = [
        {
            "leg": k + 1,
            "start_s": 14_400.0 * k,
            "surfacing_s": 14_400.0 * (k + 1),
            "heading_deg": values.pop(f"heading_{k + 1}", 80.0),
            "glide_angle_deg": 20.0,
            "depth_m": 500.0,
            "longitude": 5.1 + 0.1 * k,
            "latitude": 62.0,
            "ellipse_longitude": 5.1 + 0.1 * k,
            "ellipse_latitude": 62.0,
            "ellipse_major_m": 2000.0,
            "ellipse_minor_m": 500.0,
            "ellipse_bearing_deg": 30.0,
        }
        for k in range(2)
    ]
    made = Plan(
        status="reached",
        message="meets the goal",
        start=Place(5.0, 62.0, 0.0),
        goal=Place(5.5, 62.0, 100.0),
        start_time_ns=time_ns,
        heading_deg=80.0,
        glide_angle_deg=20.0,
        speed=0.3,
        velocity_through_water=np.zeros(3),
        duration=28_800.0,
        closest_approach=12.0,
        track_time=np.empty(0),
        track=np.empty((0, 3)),
        legs=tuple(legs),
        energy=250_000.0,
        battery=1_000_000.0,
        odds=Odds(10, 0.9, 1.0, 250.0, 9e4, 7e4, 8e4),
    )
    return replace(made, **values)


def outcome(time_ns: int, planned_ns: int, *, inside: bool) -> Any:
    return decode(
        "PlanOutcome",
        encode(
            "PlanOutcome",
            {
                "timestamp": stamp(time_ns),
                "planned_time": stamp(planned_ns),
                "distance": 3500.0,
                "direction_deg": 270.0,
                "delay": 600.0,
                "inside_ellipse": inside,
                "ellipse_major": 2000.0,
            },
        ),
    )


def mean_current(
    time_ns: int,
    measured: tuple[float, float] | None,
    predicted: tuple[float, float],
    std: float,
    corrected: tuple[float, float] | None = None,
    **errors: float,
) -> Columns:
    """Return the columns of a dive of one mean current; what was not measured or corrected is None."""
    known, used = (None if each is None else np.array(each) for each in (measured, corrected))
    off = np.array([corrected or measured]) - np.array([predicted])
    return columns_of(
        block_of(
            [
                Innovation(
                    time_ns=time_ns,
                    depth=np.zeros(1),
                    innovation=off,
                    innovation_std=np.full((1, 2), std),
                    residual=off,
                    prior_innovation=off,
                    nis=1.0,
                    dof=2,
                    accepted=True,
                    error_inflation=1.0,
                    flags=np.ones(1, np.int8),
                    reasons=np.zeros(1, np.int32),
                    dive=7,
                    source=Source(0, "/dac", 1, time_ns),
                    mean_kind="dac",
                    mean_current=known,
                    corrected_current=used,
                    **errors,
                )
            ]
        )
    )


def held(**values: Any) -> Held:
    """A vehicle that came 18 km nearer to its goal in two days, with a plan made an hour ago."""
    end = START_NS + 48 * HOUR_NS
    given = {
        "name": "r.mcap",
        "last_ns": end,
        "metadata": {
            "replay_kit.forecast": {
                "first": "2023-11-14T00:00:00Z",
                "last": "2023-11-18T00:00:00Z",
                "evolves": "true",
            }
        },
        "settings": {"measurements": {"fix_std": 20.0}},
        "outcome": Outcome(nis_per_dof=1.0),
        "projection": Projection(5.0, 62.0),
        "fixes": [
            Fix(START_NS, 4.65, 62.0, False),
            Fix(end - 25 * HOUR_NS, 4.9, 62.0, False),
            Fix(end, 5.0, 62.0, False),
        ],
        "reckoned": None,
        "plans": [plan(end - 4 * HOUR_NS, heading_2=60.0), plan(end)],
        "outcomes": [outcome(end, end - 4 * HOUR_NS, inside=True)],
        "dive": mean_current(end, (0.1, 0.0), (0.0, 0.0), 0.02),
    }
    return Held(**(given | values))
