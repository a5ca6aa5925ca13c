"""Lawn-mowers drawn in a box, and ways past random places in it: what a map's plan is compared with."""

import numpy as np

from planners.front.current import Complex
from planners.learning.loops import Survey
from planners.learning.mapping import COUNTED, Mapping
from replay_kit.core.arrays import Array

# Most lanes of a lawn-mower.
_LANES = 8


def lawn_mowers(mapping: Mapping) -> Survey:
    """Return lawn-mowers through the box from the start, by the number, direction and side of their lanes; each goes on to and fro.

    Args:
        mapping: What is to be mapped.
    """
    low, high = mapping.box.min(axis=0), mapping.box.max(axis=0)
    tracks = []
    for lanes in range(1, _LANES + 1):
        for turned in (False, True):
            for first in (False, True):
                for side in (False, True):
                    tracks.append(_mower(low, high, lanes, (turned, first, side)))
    ways = [_spaced(mapping, corners) for corners in tracks]
    middles, ends = np.array([one[0] for one in ways]), np.array([one[1] for one in ways])
    return Survey(ends, ends, middles, mapping.profile_times, np.ones(len(ends), dtype=bool))


def _mower(low: Array, high: Array, lanes: int, turns: tuple[bool, bool, bool]) -> Complex:
    """Return the corners of a lawn-mower over a box; lanes lie in the middle of their strips."""
    turned, first, side = turns
    across = (np.arange(lanes) + 0.5) / lanes
    across = across[::-1] if first else across
    # lanes end half a strip from the box's edge, but where the box is short
    inset = min(0.5 / lanes, 0.25)
    corners = []
    for k, share in enumerate(across):
        ends = (inset, 1.0 - inset) if (k % 2 == 0) != side else (1.0 - inset, inset)
        corners += [(along, share) if not turned else (share, along) for along in ends]
    unit = np.array(corners)
    places = low + unit * (high - low)
    return places[:, 0] + 1j * places[:, 1]


def _spaced(mapping: Mapping, corners: Complex) -> tuple[Complex, Complex]:
    """Return middles and ends of the legs along a track from the start past corners, to and fro, in the current that is known."""
    track = np.concatenate(
        [[mapping.start], corners, corners[-2::-1], corners[1:], corners[-2::-1]]
    )
    middles, ends, place, next_corner = list[complex](), list[complex](), mapping.start, 1
    for step in range(mapping.times.size - 1):
        left = float(mapping.times[step + 1] - mapping.times[step])
        begin = place
        while left > 0.0 and next_corner < track.size:
            way = complex(track[next_corner]) - place
            if abs(way) < 1.0:
                next_corner += 1
                continue
            speed = _over_ground(mapping, place, way / abs(way), float(mapping.profile_times[step]))
            spent = min(left, abs(way) / speed)
            place, left = place + way / abs(way) * speed * spent, left - spent
            next_corner += spent * speed >= abs(way) - 1e-6
        middles.append(0.5 * (begin + place))
        ends.append(place)
    return np.array(middles), np.array(ends)


def _over_ground(mapping: Mapping, place: complex, direction: complex, time: float) -> float:
    u = complex(mapping.mean.at(np.array([place]), time)[0]) * direction.conjugate()
    return max(float(np.sqrt(max((COUNTED * mapping.speed) ** 2 - u.imag**2, 0.0))) + u.real, 0.02)
