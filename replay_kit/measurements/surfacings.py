"""Where a vehicle surfaces, seen in the events of a replay."""

from dataclasses import dataclass

from replay_kit.core.arrays import replace
from replay_kit.core.observation import Measurement, Observation, Profiles, VehicleState
from replay_kit.measurements.dives import dive_begins


@dataclass(frozen=True, slots=True)
class SurfacingState:
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


def detect_surfacing(
    state: SurfacingState, event: VehicleState | Measurement, surface_depth: float
) -> tuple[SurfacingState, VehicleState | None]:
    """Return the state after an event, and the fix at which the vehicle is now seen to have surfaced; None when it is not.

    That is the first measured position after a dive that is not below the surface depth. Where positions have no depths, it is the last
    measured one before the first profile of the next dive. ``dives.submerged`` is the rule for where a dive begins and ends.

    Args:
        state: Before it.
        event: A position or a measurement, in the order of the log.
        surface_depth: [m], shallower than this the vehicle is at the surface.
    """
    if isinstance(event, VehicleState):
        if event.dead_reckoned or event.depth > surface_depth:
            # a dive ends with a fix; a position that was computed may come up before it
            under = state.submerged or bool(dive_begins(event.depth, surface_depth))
            return replace(state, submerged=under), None
        if state.submerged:
            return SurfacingState(False, state.dive), event
        return replace(state, fix=event), None
    if not isinstance(event, Observation | Profiles) or event.dive <= state.dive:
        return state, None
    unseen = None if state.reported else state.fix
    return SurfacingState(state.submerged, event.dive, False), unseen
