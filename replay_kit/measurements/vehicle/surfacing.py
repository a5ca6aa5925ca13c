"""How a surfacing is seen in a log: by depths, or where they say nothing by the number of the dive."""

from dataclasses import dataclass, replace

from replay_kit.core.observation import Measurement, Observation, VehicleState

# surface depths below which a dive begins, as in the measurement step
_SUBMERGED = 2.0


@dataclass(frozen=True, slots=True)
class SurfacingWatch:
    """What is remembered between events.

    Attributes:
        submerged: Whether the vehicle is in a dive, by its positions' depths.
        dive: Number of the last dive that a profile belonged to.
        reported: Whether the surfacing after that dive was seen.
        fix: Last measured position since the last surfacing; None without.
    """

    submerged: bool = False
    dive: int = 0
    reported: bool = True
    fix: VehicleState | None = None


def watched(watch: SurfacingWatch, event: VehicleState | Measurement, surface_depth: float) -> tuple[SurfacingWatch, VehicleState | None]:
    """Return the watch after an event, and the fix at which the vehicle is now seen to have surfaced; None when it is not.

    That is the first measured position after a dive that is not below the surface depth. Where positions have no depths, it is the last
    measured one before the first profile of the next dive. A dive begins below twice the surface depth and ends above it.

    Args:
        watch: Before it.
        event: A position or a measurement, in the order of the log.
        surface_depth: [m], shallower than this the vehicle is at the surface.
    """
    if isinstance(event, VehicleState):
        below = event.depth > surface_depth
        submerged = event.depth > _SUBMERGED * surface_depth or (watch.submerged and not event.depth <= surface_depth)
        if event.dead_reckoned or below:
            # a dive ends with a fix; a position that was computed may come up before it
            return replace(watch, submerged=submerged or watch.submerged), None
        if watch.submerged:
            return SurfacingWatch(False, watch.dive, True, None), event
        return replace(watch, fix=event), None
    if not isinstance(event, Observation) or event.dive <= watch.dive:
        return watch, None
    unseen = None if watch.reported else watch.fix
    return SurfacingWatch(watch.submerged, event.dive, False, None), unseen
