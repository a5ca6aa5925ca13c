"""The front's slow twins: one edge at a time, one point at a time, one pair of segments at a time."""

import heapq
from math import ceil, gcd, hypot, inf, sqrt


def edge_duration(
    current, speed: float, begin: complex, end: complex, depart: float, longest_piece: float
) -> float:
    """Return the duration of a straight track over ground, or infinity; ``current`` is a function of place and time."""
    length = abs(end - begin)
    pieces = max(ceil(length / longest_piece - 1e-6), 1)
    direction, seconds = (end - begin) / length, 0.0
    for k in range(pieces):
        u = current(
            begin + (k + 0.5) / pieces * (end - begin),
            depart + seconds + 0.5 * length / pieces / speed,
        )
        along = u.real * direction.real + u.imag * direction.imag
        across = u.imag * direction.real - u.real * direction.imag
        if abs(across) >= speed or along + sqrt(speed**2 - across**2) <= 1e-3:
            return inf
        seconds += length / pieces / (along + sqrt(speed**2 - across**2))
    return seconds


def arrivals(shape: tuple[int, int], reach: int, first: int, duration) -> list[float]:
    """Return when each point of a lattice is reached first, by Dijkstra's search; ``duration`` is a function of two points and a time."""
    times, queue, done = [inf] * (shape[0] * shape[1]), [(0.0, first)], set()
    times[first] = 0.0
    while queue:
        now, here = heapq.heappop(queue)
        if here in done:
            continue
        done.add(here)
        row, column = divmod(here, shape[1])
        for a in range(-reach, reach + 1):
            for b in range(-reach, reach + 1):
                if gcd(a, b) == 1 and 0 <= row + a < shape[0] and 0 <= column + b < shape[1]:
                    there = (row + a) * shape[1] + column + b
                    arrives = now + duration(here, there, now)
                    if arrives < times[there]:
                        times[there] = arrives
                        heapq.heappush(queue, (arrives, there))
    return times


def touches(begin: complex, end: complex, first: complex, last: complex) -> bool:
    """Return whether two segments touch: the ends of each lie on different sides of the other."""

    def side(a: complex, b: complex, c: complex) -> float:
        return ((b - a).conjugate() * (c - a)).imag

    def within(a: complex, b: complex, c: complex) -> bool:
        return abs(side(a, b, c)) == 0.0 and hypot((c - a).real, (c - a).imag) + abs(c - b) <= abs(
            b - a
        ) * (1 + 1e-12)

    crossing = (
        side(begin, end, first) * side(begin, end, last) < 0.0
        and side(first, last, begin) * side(first, last, end) < 0.0
    )
    return crossing or any(
        (
            within(begin, end, first),
            within(begin, end, last),
            within(first, last, begin),
            within(first, last, end),
        )
    )
