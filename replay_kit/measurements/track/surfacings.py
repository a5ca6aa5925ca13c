"""Detection of surfacings in the events of a replay."""

from dataclasses import dataclass

from replay_kit.core.arrays import replace
from replay_kit.core.observation import Measurement, Observation, Profiles, VehicleState
from replay_kit.measurements.track.dives import dive_begins


@dataclass(frozen=True, slots=True)
class SurfacingState:
    """State between events.

    Attributes:
        submerged: Whether the vehicle is in a dive, by the depths of its positions.
        dive: Number of the last dive with a profile.
        reported: Whether the surfacing after that dive was detected.
        fix: Last measured position since the last surfacing; None without.
    """

    submerged: bool = False
    dive: int = 0
    reported: bool = True
    fix: VehicleState | None = None


def detect_surfacing(
    state: SurfacingState, event: VehicleState | Measurement, surface_depth: float
) -> tuple[SurfacingState, VehicleState | None]:
    """Return the state after an event, and the fix of a newly detected surfacing, or None.

    It is the first measured position after a dive at or above the surface depth. Without depths it is the last measured one before the
    first profile of the next dive. Dives are defined by ``dives.submerged``.

    Args:
        state: State before the event.
        event: Position or measurement, in the order of the log.
        surface_depth: Depth above which the vehicle is at the surface [m].
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
