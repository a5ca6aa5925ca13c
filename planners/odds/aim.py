"""Heading and glide angle towards a target in an expected current."""

import numpy as np

from planners.vehicle import Glider
from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import true_north_halfway
from replay_kit.core.grid import Projection

# Glide angles among which the aim is sought.
_ANGLES = 32


def mean_current(
    projection: Projection,
    flown: tuple[Glider, tuple[Array, Array], Array | float],
    ends: tuple[Array, Array],
    lasts: Array,
) -> Array:
    """Return the mean local current of legs from dead reckoning, shape (K, 2) [m/s].

    Args:
        projection: Local frame.
        flown: Glider, headings and glide angles, shape (K,) [rad], and summed heights of dives and climbs [m].
        ends: Begin and end positions, shape (K, 2) [m].
        lasts: Duration with the drift, shape (K,) [s].
    """
    (vehicle, (heading, angle), height), (begin, end) = flown, ends
    along, down = vehicle.speeds(np, angle)
    local = heading + true_north_halfway(projection, begin, end)
    through = (along * height / down)[:, None] * np.column_stack([np.sin(local), np.cos(local)])
    return np.asarray((end - begin - through) / lasts[:, None])


def home(
    vehicle: Glider, displacement: Array, current: Array, dive: tuple[Array, Array], drift: Array
) -> tuple[Array, Array]:
    """Return headings of self-steering gliders [rad from local north] and the fractions of a dive that reach the waypoint, shape (K,).

    Args:
        vehicle: Glider.
        displacement: Displacement to the waypoint, shape (K, 2) [m].
        current: Expected mean current over a dive and its drift, shape (K, 2) [m/s].
        dive: Glide angles [rad] and summed heights of dives and climbs [m], shape (K,) each.
        drift: Drift time after the leg, shape (K,) [s].
    """
    angle, height = dive
    along, down = vehicle.speeds(np, angle)
    under, distance = height / down, np.maximum(np.linalg.norm(displacement, axis=1), 1e-3)
    ahead = displacement / distance[:, None]
    off = np.column_stack([-ahead[:, 1], ahead[:, 0]])
    set_across, set_ahead = np.sum(current * off, axis=1), np.sum(current * ahead, axis=1)
    found = list[tuple[Array, Array]]()
    # on the way the drift at the surface counts as well; the last dive is to come up at the waypoint
    for duration in (under + drift, under):
        speed = along * under / duration
        # of the speed through water as much across as the current sets, the rest ahead
        across = np.clip(-set_across, -speed, speed)
        through = np.sqrt(speed**2 - across**2)
        made_good = np.maximum(set_ahead + through, 1e-3 * speed)
        way = across[:, None] * off + through[:, None] * ahead
        found.append((np.arctan2(*way.T), np.minimum(distance / (made_good * duration), 1.0)))
    whole = found[0][1] >= 1.0
    heading, share = (np.where(whole, *both) for both in zip(*found, strict=True))
    return heading, share


def aim(
    vehicle: Glider, displacement: Array, current: Array, height: Array, drift: Array
) -> tuple[Array, Array]:
    """Return the heading from local north and the glide angle towards a target in a mean current, shape (K,) each [rad].

    The steepest angle that reaches the target is the fastest. If none does, the angle with the least miss distance is returned.

    Args:
        vehicle: Glider.
        displacement: Displacement to the target over ground, shape (K, 2) [m].
        current: Mean current over the leg and its drift, shape (K, 2) [m/s].
        height: Summed heights of the leg's dives and climbs, shape (K,) [m].
        drift: Drift time after the leg, shape (K,) [s].
    """
    angles = np.linspace(*vehicle.angles, _ANGLES)

    def lacking(angle: Array) -> tuple[Array, Array]:
        """Return the displacement required through water, shape (K, n, 2) [m], and the part out of reach."""
        along, down = vehicle.speeds(np, angle)
        lasts = height[:, None] / down
        needed = displacement[:, None] - current[:, None] * (lasts + drift[:, None])[..., None]
        return needed, np.linalg.norm(needed, axis=-1) - along * lasts

    short = lacking(angles[None])[1]
    rows, reaches = np.arange(len(displacement)), short <= 0.0
    last = _ANGLES - 1 - np.argmax(reaches[:, ::-1], axis=1)
    best = np.where(reaches.any(axis=1), last, np.argmin(short, axis=1))
    steeper = np.minimum(best + 1, _ANGLES - 1)
    here, there = short[rows, best], short[rows, steeper]
    between = reaches.any(axis=1) & (there > 0.0)
    share = np.where(between, -here / np.where(between, there - here, 1.0), 0.0)
    angle = angles[best] + share * (angles[steeper] - angles[best])
    towards = lacking(angle[:, None])[0][:, 0]
    return np.arctan2(towards[:, 0], towards[:, 1]), angle
