"""The earliest arrival: against Zermelo's rays, and missions above its bound."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np

from planners import MissionRequest, MissionSettings, plan_mission
from planners.route.current import CurrentLattice, current_lattice, shares_of_levels, spacing_over
from planners.route.front import sea_of, spread_front
from planners.route.passage import relax
from planners.simulation.currents import currents_of
from replay_kit.core.errors import PlanError
from replay_kit.core.flow.estimate import FlowEstimate
from tests.benchmarks.islands import bounds, islands, members_flow, random_area
from tests.benchmarks.measure import Row, cpu, row
from tests.planners.flow_samples import eddying_flow, request_between
from tests.reference.rays import fan, in_front

DAY = 86400.0
# Depth of the water that a vehicle flies through on average [m].
_DEPTH = 800.0


def rows(tiny: bool) -> list[Row]:
    """Return what was measured."""
    flows = _flows(tiny)
    if tiny:
        return [ray_row(flows, 0.6, 0.2, 4), bound_row("free", _case, 1)]
    # the second as slow as the current: told, not held to the same
    made = [ray_row(flows, 0.6, 2.0, 20), ray_row(flows, 0.29, 4.0, 20)]
    return [*made, bound_row("free", _case, 40), bound_row("masked", masked_case, 40)]


def _flows(tiny: bool) -> tuple[FlowEstimate, ...]:
    """Return pairs of flows, one after the other, between which the current changes."""
    count = 2 if tiny else 6
    return tuple(
        members_flow(member, tiny) or eddying_flow(seed, speed=0.2)
        for seed, member in enumerate((5, 6, 23, 24, 41, 42)[:count])
    )


def _times_of(
    current: CurrentLattice, speed: float, begin, ends, until: float
) -> tuple[np.ndarray, float]:
    """Return when a front is at some places [s], relaxed off the lattice, and the processor time of the front alone [s]."""
    places, first = np.vstack([begin, ends]) @ [1.0, 1.0j], current.places.size

    def flood() -> tuple[Any, Any]:
        sea = sea_of(current, speed, places)
        return sea, spread_front(sea, np.array([first]), np.zeros(1), until, np.zeros(0, dtype=int))

    took, (sea, front) = cpu(flood)
    numbers = first + 1 + np.arange(len(ends))
    arrived = [
        float(relax(sea, front.route_to(int(n), 0.0, True), 0.0).times[-1])
        if np.isfinite(front.times[n])
        else np.inf
        for n in numbers
    ]
    return np.array(arrived), took


def ray_row(flows: tuple[FlowEstimate, ...], speed: float, days: float, count: int) -> Row:
    """Ends of Zermelo's rays that no other overtook, in a current that changes from one flow to another within ten days."""
    errors, took, rng, fastest = list[float](), 0.0, np.random.default_rng(5), 0.0
    for one, other in zip(flows[::2], flows[1::2], strict=True):
        times = np.arange(0.0, (days + 1.0) * DAY, 0.5 * DAY)
        latent = np.hstack(
            [one.latent + at / (10.0 * DAY) * (other.latent - one.latent) for at in times]
        )
        shares = shares_of_levels(currents_of(one), min(_DEPTH, float(one.levels[-1])), 0.05)
        made, current = cpu(lambda: current_lattice(one, latent, times, spacing_over(one), shares))  # noqa: B023
        mean = np.stack([part @ shares for part in np.split(latent, times.size, axis=1)], axis=1)

        def velocity(at, now: float) -> np.ndarray:
            weights = np.array([np.interp(now, times, unit) for unit in np.eye(times.size)])  # noqa: B023
            return one.horizontal.velocity(at, (mean @ weights)[:, None])[..., 0]  # noqa: B023

        low, high = bounds(one)
        begin = 0.5 * (low + high) + rng.uniform(-0.1, 0.1, 2) * (high - low)
        fans = fan(
            velocity,
            begin,
            speed,
            np.linspace(0.0, 2.0 * np.pi, 720, endpoint=False),
            np.linspace(0.0, days * DAY, 97)[1:],
        )
        apart = np.max(
            np.linalg.norm(np.diff(fans[-1], axis=0, append=fans[-1, :1]), axis=1, keepdims=True),
            axis=1,
        )
        inside = np.all((fans > low) & (fans < high), axis=(0, 2))
        usable = np.flatnonzero(
            in_front(fans, 100.0) & inside & (apart < 3e3) & (np.roll(apart, 1) < 3e3)
        )
        ends = (
            fans[-1, rng.choice(usable, min(count, usable.size), replace=False)]
            if usable.size
            else np.zeros((0, 2))
        )
        found, seconds = _times_of(current, speed, begin, ends, 1.2 * days * DAY)
        errors += list(found / (days * DAY) - 1.0)
        took, fastest = max(took, made + seconds), max(fastest, current.fastest)
    off = np.array(errors)
    known = np.abs(off[np.isfinite(off)])
    error, more = dict[str, float](), {"not_reached": off.size - known.size, "asked_s": 0.5}
    if known.size:
        error = {"off_mean_share": known.mean(), "off_ninety_five_share": np.quantile(known, 0.95)}
        more |= {"earliest": off.min(), "latest": off.max()}
    where = f"{days:g} days in currents up to {fastest:.2f} m/s that change, {off.size} rays"
    name = f"earliest arrival at {speed} m/s after {where}: mean 0.3 %, 95 in 100 within 1 % asked"
    return row(name, took, "Zermelo's rays", error=error, **more)


def bound_row(
    kind: str, case: Callable[[int], tuple[FlowEstimate, MissionRequest]], count: int
) -> Row:
    """How far missions that arrive lie above the earliest arrival of any vehicle."""
    above, took, missed = list[float](), list[float](), 0
    for k in range(count):
        with suppress(PlanError):
            flow, request = case(k)
            spent, plan = cpu(lambda: plan_mission(flow, request))  # noqa: B023
            took.append(spent)
            found = plan.statistics.get("above_bound_percent")
            missed += found is None
            above += [] if found is None else [float(found)]
    more = {"not_reached": missed, "slowest_s": max(took)}
    if above:
        more |= {"above_median": np.median(above), "above_ninety": np.quantile(above, 0.9)}
    error = {"below": float(np.sum(np.array(above) < 0.0))}
    name = f"{len(above)} missions, {kind}: median 2.5 %, nine of ten 5 % above the earliest arrival asked"
    return row(name, float(np.median(took)), "lower bound", error=error, **more)


def _limits(flow: FlowEstimate) -> np.ndarray:
    return 0.7 * np.array([flow.grid.east.max(), flow.grid.north.max()])


def _case(seed: int) -> tuple[FlowEstimate, MissionRequest]:
    """Return a mission in a current slower than the vehicle."""
    rng, flow = np.random.default_rng(900 + seed), eddying_flow(seed, speed=0.1)
    begin, end = rng.uniform(-_limits(flow), _limits(flow), (2, 2))
    settings = MissionSettings(depth=390.0, surface_time=600.0)
    return flow, request_between(flow, begin, end, settings=settings)


def masked_case(seed: int) -> tuple[FlowEstimate, MissionRequest]:
    """Return a mission among islands and areas that may not be entered at any depth."""
    flow, request = _case(seed)
    rng = np.random.default_rng(950 + seed)
    flow = islands(flow, rng)
    limits = _limits(flow)
    drawn = (random_area(flow, rng.uniform(-limits, limits), rng, f"area {k}") for k in range(3))
    return flow, replace(request, no_go=tuple(replace(one, surface_only=False) for one in drawn))
