"""A route, and how long a vehicle of constant speed through water takes along a straight line over ground (Zermelo 1931)."""

from dataclasses import dataclass

import numpy as np

from planners.front.current import Complex, CurrentLattice
from replay_kit.core.arrays import Array


@dataclass(frozen=True, slots=True, eq=False)
class Route:
    """A way from a start to a goal, or as near to it as can be reached.

    Attributes:
        points: shape (n, 2) [m], local east and north.
        times: shape (n,) [s], when each is reached, since the beginning.
        arrives: Whether it ends at its goal; otherwise at the point nearest to it that can be reached.
    """

    points: Array
    times: Array
    arrives: bool

    def at(self, times: Array) -> Array:
        """Return the points, shape (m, 2) [m], of times [s]."""
        return np.column_stack([np.interp(times, self.times, self.points[:, i]) for i in (0, 1)])


# Speed made good below which an edge is closed [m/s].
SLOWEST = 1e-3


def edge_durations(
    current: CurrentLattice,
    speed: float,
    begin: Complex,
    end: Complex,
    depart: Array,
    longest_piece: float,
) -> Array:
    """Return the durations, shape (n,) [s], of straight tracks over ground; infinite for those along which the vehicle cannot stay.

    Each is cut into equal pieces. With u the current at the piece's middle, in place and time, u_par along the track and u_perp across
    it, the vehicle heads off u_perp and makes good u_par + sqrt(V^2 - u_perp^2).

    Args:
        current: The current.
        speed: V, through water [m/s].
        begin: shape (n,), where they begin [m], east + i north.
        end: shape (n,), where they end.
        depart: shape (n,), when they begin [s].
        longest_piece: Longest piece [m].
    """
    way = end - begin
    length = np.abs(way)
    direction = way / np.maximum(length, 1e-9)
    pieces = np.maximum(np.ceil(length / longest_piece - 1e-6), 1.0)
    piece = length / pieces
    seconds = np.zeros(length.size)
    for k in range(int(pieces.max(initial=0.0))):
        open_ = np.flatnonzero((pieces > k) & np.isfinite(seconds))
        along, lasts = direction[open_], piece[open_]
        middle = begin[open_] + (k + 0.5) * lasts * along
        turned = (
            current.at(middle, depart[open_] + seconds[open_] + 0.5 / speed * lasts) * along.conj()
        )
        room = speed**2 - turned.imag**2
        made_good = turned.real + np.sqrt(np.maximum(room, 0.0))
        closed = (room <= 0.0) | (made_good <= SLOWEST)
        seconds[open_] += np.where(closed, np.inf, lasts / np.where(closed, 1.0, made_good))
    return seconds
