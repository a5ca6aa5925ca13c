"""A pilot's slow twin: many gliders, each in a current of its own, told at each surfacing where to head."""

from dataclasses import dataclass

import numpy as np

from planners import MissionPlan
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.geodesy import (
    grid_bearing_of_true_north,
    rate_in_frame,
    to_geographic,
    to_local,
)
from tests.reference.lattice import matrix as functions_at

# Longest step [s], spacing of the places looked at along a route [m], glide angles tried, depths of a mean.
STEP, SPACING, ANGLES, DEPTHS = 200.0, 4.0, 401, 25


@dataclass(frozen=True, slots=True, eq=False)
class Flown:
    """Flights of K gliders.

    Attributes:
        when: shape (K,), when each arrives [s]; infinite for never.
        up: shape (D, K, 2), where each comes up after each dive [m]; where it came up last once it is over.
        ends: shape (D, K, 2), the same after the drift, which one that has arrived does not make.
    """

    when: np.ndarray
    up: np.ndarray
    ends: np.ndarray


def drawn(flow: FlowEstimate, count: int, seed: int) -> np.ndarray:
    """Return latent values of draws of an estimate whose weights are known by their covariance, shape (K, M, Z)."""
    values, vectors = np.linalg.eigh(flow.unknowns.p)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    normal = np.random.default_rng(seed).standard_normal((count, len(values)))
    weights = (normal @ root.T).reshape(count, flow.levels.size, -1)
    return flow.latent + np.einsum("mr,kzr->kmz", flow.modes, weights)


def currents(flow, latents, at, depths):
    """Velocity at places, shape (K, 2) [m], and depths, shape (K,), each in latent values of its own, shape (K, M, Z) or (1, M, Z)."""
    z = flow.levels
    hats = np.stack([np.interp(depths, z, unit) for unit in np.eye(z.size)], axis=-1)
    each = np.einsum("kmz,kz->km", np.broadcast_to(latents, (len(at), *latents.shape[1:])), hats)
    rows = functions_at(flow.horizontal, at).reshape(2, len(at), -1)
    return np.einsum("ckm,km->kc", rows, each)


def fly_steered(
    flow: FlowEstimate, latents: np.ndarray, plan: MissionPlan, radius: float, deadline: float
) -> Flown:
    """Return the flights of gliders to the one goal of a mission, at the surface, along its route."""
    frame, vehicle, drift = flow.grid.projection, plan.vehicle, plan.settings.surface_time
    count = len(latents)
    at = np.tile(to_local(frame, plan.start.longitude, plan.start.latitude), (count, 1))
    goal = np.array(to_local(frame, plan.goals[-1].longitude, plan.goals[-1].latitude))
    ends = np.column_stack(to_local(frame, *plan.surfacings.T))
    route, fine, leg_of, lengths = _dense(np.vstack([at[:1], ends]))
    deep = np.array([max(leg) for leg in plan.yo_depths])
    now, when, so_far = np.zeros(count), np.full(count, np.inf), np.zeros(count, dtype=int)
    error, ups, downs = np.zeros((count, 2)), [], []
    open_, number = np.full(count, True), 0

    def step(at, depth, change, through, lasts, steps):
        for k in range(steps):
            half, full = (depth + change * (k + part) / steps for part in (0.0, 0.5))
            dt = (lasts / steps)[:, None]

            def rate(where, z):
                u = currents(flow, latents, where, z)
                return np.column_stack(rate_in_frame(frame, *where.T, tuple(through.T), tuple(u.T)))

            at = at + dt * rate(at + 0.5 * dt * rate(at, half), full)
        return at

    while open_.any():
        for k in range(count):
            beyond = np.linalg.norm(route[so_far[k] :] - at[k], axis=1)
            so_far[k] += int(np.argmin(beyond))
        leg = np.minimum((leg_of[so_far] + 0.25).astype(int), len(ends) - 1)
        other = np.minimum((leg_of[so_far] + 0.75).astype(int), len(ends) - 1)
        along = np.interp(leg_of[so_far] + 1.0, leg_of, fine)
        along = np.minimum(np.maximum(along, fine[so_far] + 500.0), fine[-1])
        last = fine[-1] - along < 0.5 * lengths[leg]
        target = np.column_stack([np.interp(along, fine, route[:, k]) for k in (0, 1)])
        to = np.where(last[:, None], goal, target)
        depth, rest = np.minimum(deep[leg], deep[other]), np.where(last, 0.0, drift)
        known = _expected(flow, vehicle, (at, to), depth, rest)
        heading, angle = _aim(vehicle, to - at, known + error, 2.0 * depth, rest)
        way = np.column_stack(to_geographic(frame, *(0.5 * (at + to)).T))
        heading = heading - grid_bearing_of_true_north(frame, *way.T)
        if number == 0:
            heading = np.full(count, np.deg2rad(plan.headings_deg[0]))
            angle = np.full(count, np.deg2rad(plan.glide_angles_deg[0]))
        flat, down = vehicle.speeds(np, angle)
        down = np.broadcast_to(down, count)
        through = flat[:, None] * np.column_stack([np.sin(heading), np.cos(heading)])
        half, begin = depth / down, at
        steps = int(np.ceil(half.max() / STEP))
        at = step(at, np.zeros(count), depth, through, half, steps)
        at = step(at, depth, -depth, through, half, steps)
        up, lasts = at, 2.0 * half
        off = np.linalg.norm(up - goal, axis=1)
        arrives = open_ & (off <= radius) & (now + lasts <= deadline)
        when[arrives] = (now + lasts)[arrives]
        ups.append(np.where(open_[:, None], up, ups[-1] if ups else up))
        if drift > 0.0:
            still, long = np.zeros((count, 2)), np.full(count, drift)
            at = step(at, np.zeros(count), np.zeros(count), still, long, 3)
        stays = np.where(arrives[:, None], up, at)
        downs.append(np.where(open_[:, None], stays, downs[-1] if downs else at))
        lasts = lasts + drift
        middle = np.column_stack(to_geographic(frame, *(0.5 * (begin + at)).T))
        local = heading + grid_bearing_of_true_north(frame, *middle.T)
        steered = (flat * 2.0 * half)[:, None] * np.column_stack([np.sin(local), np.cos(local)])
        error = (at - begin - steered) / lasts[:, None] - known
        now = now + lasts
        open_ &= ~arrives & (now <= deadline)
        number += 1
    return Flown(when, np.array(ups), np.array(downs))


def _dense(places):
    """Places along a route, how far and how many legs each is along it, and the legs' lengths [m]."""
    lengths = np.linalg.norm(np.diff(places, axis=0), axis=1)
    along = np.append(0.0, np.cumsum(lengths))
    fine = np.arange(0.0, along[-1], SPACING)
    fine = np.append(fine, along[-1])
    route = np.column_stack([np.interp(fine, along, places[:, k]) for k in (0, 1)])
    return route, fine, np.interp(fine, along, np.arange(len(places))), lengths


def _expected(flow, vehicle, ends, depth, drift):
    """Mean current of the estimate half way, over a dive and the drift after it."""
    at, to = ends
    flat, down = (float(speed) for speed in vehicle.speeds(np, vehicle.angles[0]))
    lasts = 2.0 * depth / down
    reach = np.minimum(flat * lasts / np.linalg.norm(to - at, axis=1), 1.0)
    middle = at + 0.5 * reach[:, None] * (to - at)
    mean = np.mean(
        [
            currents(flow, flow.latent[None], middle, share * depth)
            for share in (np.arange(DEPTHS) + 0.5) / DEPTHS
        ],
        axis=0,
    )
    top = currents(flow, flow.latent[None], middle, np.zeros(len(at)))
    return (lasts[:, None] * mean + drift[:, None] * top) / (lasts + drift)[:, None]


def _aim(vehicle, way, current, height, drift):
    """Local heading and glide angle [rad]: the steepest angle that reaches, or the one that misses by least."""
    angles = np.linspace(*vehicle.angles, ANGLES)
    flat, down = (np.broadcast_to(speed, ANGLES) for speed in vehicle.speeds(np, angles))
    lasts = height[:, None] / down
    needed = way[:, None] - current[:, None] * (lasts + drift[:, None])[..., None]
    short = np.linalg.norm(needed, axis=-1) - flat * lasts
    fits = short <= 0.0
    best = np.where(
        fits.any(axis=1), ANGLES - 1 - np.argmax(fits[:, ::-1], axis=1), np.argmin(short, axis=1)
    )
    rows = np.arange(len(way))
    return np.arctan2(*needed[rows, best].T), angles[best]
