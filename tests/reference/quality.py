"""The obvious way to judge bins: one bin, one number at a time."""

import math
import statistics

GOOD, NOT_EVALUATED, SUSPECT, FAIL = 1, 2, 3, 4


def graded(value, suspect, fail, least):
    """Return the flag of one number."""
    if (suspect is None and fail is None) or math.isnan(value):
        return NOT_EVALUATED
    for limit, flag in ((fail, FAIL), (suspect, SUSPECT)):
        if limit is not None and (value < limit if least else value > limit):
            return flag
    return GOOD


def third_best(beams):
    """Return the number of the third best beam of a cell, of the worst where there are fewer; NaN when too few have one."""
    known = sorted((value for value in beams if not math.isnan(value)), reverse=True)
    needed = min(3, len(beams))
    return known[needed - 1] if len(known) >= needed else math.nan


def tilt(pitch, roll):
    """Return the angle of a body's z axis to the vertical after a roll about x, then a pitch about y."""
    x, y, z = 0.0, -math.sin(math.radians(roll)), math.cos(math.radians(roll))
    x, z = z * math.sin(math.radians(pitch)), z * math.cos(math.radians(pitch))
    return math.degrees(math.atan2(math.hypot(x, y), abs(z)))


def outlyingness(velocity, floor, window):
    """Return by how many deviations each bin stands out, component by component; NaN where it cannot be told."""
    n, width = len(velocity), min(window, len(velocity))
    finite = [all(map(math.isfinite, row)) for row in velocity]
    if sum(finite) < 4:
        return [math.nan] * n
    around = []
    for i in range(n):
        first = min(max(i - window // 2, 0), n - width)
        around.append([k for k in range(first, first + width) if finite[k]])
    result = []
    for i in range(n):
        if not finite[i] or len(around[i]) < 4:
            result.append(math.nan)
            continue
        ratios = []
        for c in (0, 1):
            middles = [
                statistics.median(velocity[k][c] for k in around[j]) if around[j] else math.nan
                for j in range(n)
            ]
            usual = statistics.median(
                abs(velocity[j][c] - middles[j]) for j in range(n) if finite[j]
            )
            local = statistics.median(abs(velocity[k][c] - middles[i]) for k in around[i])
            ratios.append(
                abs(velocity[i][c] - middles[i]) / max(1.4826 * max(usual, local), floor[i])
            )
        result.append(max(ratios))
    return result
