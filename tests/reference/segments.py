"""The obvious way to tell legs: every stretch of a track is asked whether it is one."""


def way_of(depth: list[float], leg: float, i: int) -> int:
    """Return +1 when sample i lies in a stretch that goes down, -1 up, 0 in none; of two, the one that begins earlier.

    A stretch goes down when its first sample is its shallowest and its last its deepest, at least a leg apart, and nowhere in it
    the vehicle comes back by a leg.
    """
    found = []
    for a in range(i + 1):
        for b in range(i, len(depth)):
            for way in (1, -1):
                part = [way * value for value in depth[a : b + 1]]
                ends = part[0] == min(part) and part[-1] == max(part) and part[-1] - part[0] >= leg
                back = any(part[j] - part[k] >= leg for k in range(len(part)) for j in range(k))
                if ends and not back:
                    found.append((a, way))
    return min(found)[1] if found else 0
