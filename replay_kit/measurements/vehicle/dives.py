"""Where a dive begins and ends: the one rule for the measurement step, surfacings, segments and mean currents."""

# surface depths; below that many a dive begins, so that waves at the surface make no dives
_DIVE_BEGINS = 2.0


def dive_begins(depth: float, surface_depth: float) -> bool:
    """Return whether a depth [m] is deep enough to begin a dive: below twice the surface depth [m]; NaN never is."""
    return depth > _DIVE_BEGINS * surface_depth


def is_submerged(depth: float, surface_depth: float, before: bool) -> bool:
    """Return whether the vehicle is in a dive, which begins below twice the surface depth and ends at the surface depth.

    Args:
        depth: Of the vehicle now [m]; with NaN no dive begins or goes on.
        surface_depth: Shallower than this the vehicle is at the surface [m].
        before: Whether it was in a dive until now.
    """
    return dive_begins(depth, surface_depth) or (before and depth > surface_depth)
