"""The earliest arrival: against Zermelo's rays, and missions above its bound."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from planners import MissionRequest, MissionSettings, NoGo, plan_mission
from planners.route.current import CurrentLattice, current_lattice, shares_of_levels, spacing_over
from planners.route.front import sea_of, spread
from planners.route.passage import relax
from planners.simulation.currents import currents_of
from replay_kit.config.run import RunConfig
from replay_kit.core.errors import PlanError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.estimator.basis.modes import embed_member
from replay_kit.forecast import read_ensemble
from tests.benchmarks.islands import asked, bounds, islands, random_area
from tests.benchmarks.measure import Row, cpu, row
from tests.places import DATA
from tests.planners.flow_samples import eddying_flow
from tests.reference.rays import fan, in_front

QG = DATA / "qg" / "climatology.nc"
DAY = 86400.0
# Depth of the water that a vehicle flies through on average [m].
_DEPTH = 800.0


def rows(tiny: bool) -> list[Row]:
    """Return what was measured."""
    flows = _flows(tiny)
    made = [ray_row(flows, 0.6, *((0.2, 4) if tiny else (2.0, 20)))]
    if not tiny:
        # as slow as the current: told, not held to the same
        made += [ray_row(flows, 0.29, 4.0, 20)]
    made += [bound_row("free", free_case, 1 if tiny else 40, tiny)]
    if not tiny:
        made += [
            bound_row("masked", masked_case, 40, tiny),
            bound_row("in strong currents", strong_case, 20, tiny),
        ]
    return made


def _flows(tiny: bool) -> tuple[FlowEstimate, ...]:
    """Return pairs of flows, one after the other, between which the current changes."""
    if tiny or not QG.exists():
        return tuple(eddying_flow(seed, speed=0.2) for seed in range(2 if tiny else 6))
    config = RunConfig()
    ensemble = read_ensemble(QG, config.forecast)
    return tuple(
        embed_member(ensemble, member, config.estimator) for member in (5, 6, 23, 24, 41, 42)
    )


def _times_of(
    current: CurrentLattice, speed: float, begin, ends, until: float
) -> tuple[np.ndarray, float]:
    """Return when a front is at some places [s], relaxed off the lattice, and the processor time of the front alone [s]."""
    places, first = np.vstack([begin, ends]) @ [1.0, 1.0j], current.places.size

    def flood() -> tuple[Any, Any]:
        sea = sea_of(current, speed, places)
        return sea, spread(sea, np.array([first]), np.zeros(1), until, np.zeros(0, dtype=int))

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
    name = f"earliest arrival at {speed} m/s after {days:g} days in currents up to {fastest:.2f} m/s that change, {len(errors)} rays"
    return _error_row(name, np.array(errors), took, "Zermelo's rays")


def _error_row(name: str, errors, took: float, peer: str) -> Row:
    known = np.abs(errors[np.isfinite(errors)])
    error = (
        {"mean_share": float(np.mean(known)), "ninety_five_share": float(np.quantile(known, 0.95))}
        if known.size
        else {}
    )
    extremes = (
        {"earliest": float(np.min(errors)), "latest": float(np.max(errors))} if known.size else {}
    )
    more = {"not_reached": int(np.sum(~np.isfinite(errors))), "asked_s": 0.5, **extremes}
    return row(
        f"{name}: mean 0.3 %, 95 in 100 within 1 % asked",
        took,
        peer,
        error={f"off_{k}": v for k, v in error.items()},
        **more,
    )


def bound_row(
    kind: str, case: Callable[[int], tuple[FlowEstimate, MissionRequest]], count: int, tiny: bool
) -> Row:
    """How far missions that arrive lie above the earliest arrival of any vehicle."""
    above, took, missed = list[float](), list[float](), 0
    for k in range(count):
        try:
            flow, request = case(k)
            spent, plan = cpu(lambda: plan_mission(flow, request))  # noqa: B023
            took.append(spent)
        except PlanError:
            continue
        if "above_bound_percent" in plan.statistics:
            above.append(float(plan.statistics["above_bound_percent"]))
        else:
            missed += 1
    error = {"below": float(np.sum(np.array(above) < 0.0))}
    shares = (
        {}
        if not above
        else {
            "above_median": float(np.median(above)),
            "above_ninety": float(np.quantile(above, 0.9)),
        }
    )
    name = f"{len(above)} missions, {kind}: median 2.5 %, nine of ten 5 % above the earliest arrival asked"
    return row(
        name,
        float(np.median(took)),
        "lower bound",
        error=error,
        **shares,
        not_reached=missed,
        slowest_s=max(took),
    )


def free_case(seed: int) -> tuple[FlowEstimate, MissionRequest]:
    """Return a mission in a current slower than the vehicle."""
    return _case(seed, 0.1)


def strong_case(seed: int) -> tuple[FlowEstimate, MissionRequest]:
    """Return a mission in a current as fast as the vehicle."""
    return _case(seed, 0.25)


def _case(seed: int, speed: float) -> tuple[FlowEstimate, MissionRequest]:
    rng, flow = np.random.default_rng(900 + seed), eddying_flow(seed, speed=speed)
    limits = 0.7 * np.array([flow.grid.east.max(), flow.grid.north.max()])
    begin, end = rng.uniform(-limits, limits, (2, 2))
    settings = MissionSettings(depth=390.0, surface_time=600.0)
    return flow, asked(flow, begin, end, settings)


def masked_case(seed: int) -> tuple[FlowEstimate, MissionRequest]:
    """Return a mission among islands and areas."""
    flow, request = free_case(seed)
    rng = np.random.default_rng(950 + seed)
    flow = islands(flow, rng)
    limits = 0.7 * np.array([flow.grid.east.max(), flow.grid.north.max()])
    return flow, replace(request, no_go=_areas(flow, limits, rng, 3))


def _areas(flow: FlowEstimate, limits, rng: np.random.Generator, count: int) -> tuple[NoGo, ...]:
    """Return areas within limits about the middle that may not be entered at any depth."""
    drawn = (
        random_area(flow, rng.uniform(-limits, limits), rng, f"area {k}") for k in range(count)
    )
    return tuple(replace(area, surface_only=False) for area in drawn)
