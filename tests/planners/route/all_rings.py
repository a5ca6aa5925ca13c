"""All that a vehicle at a depth must keep clear of, put together as missions and paths do."""

from planners.hazards.areas import NoGo, Ring
from planners.hazards.domain import Bathymetry, Region, bottom_of, fixed_rings


def all_rings(
    region: Region, depth: float, no_go: tuple[NoGo, ...] = (), bathymetry: Bathymetry | None = None
) -> tuple[Ring, ...]:
    """Return the edge of the region first, then no-go areas, then land and shallows: one ring for each cell beside water."""
    bottom = bottom_of(region, bathymetry, 20.0)
    return (*fixed_rings(region, no_go, bottom), *bottom.rings(depth))
