"""What the measurement step remembers from one message to the next."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.observation import VehicleState
from replay_kit.measurements.current.mean import Dives, record_depth
from replay_kit.measurements.events import Event
from replay_kit.measurements.messages.joined import Component
from replay_kit.measurements.messages.mavlink_ping import Key, PingFrame
from replay_kit.measurements.messages.position import Pose
from replay_kit.measurements.ping.adcp_ping import PlatformVelocity
from replay_kit.measurements.ping.attitude import Orientation
from replay_kit.measurements.steps.position_matching import PlacedPing, WaitingPing
from replay_kit.measurements.vehicle.dives import is_submerged
from replay_kit.measurements.vehicle.vessel_velocity import Fixes


@dataclass(frozen=True, slots=True)
class MeasurementState:
    """What the step remembers.

    Attributes:
        fix: Last position known.
        depth: Last depth known [m]; NaN before the first.
        dive: Dives begun so far.
        submerged: Whether the vehicle is in a dive.
        origins: By topic of poses, its first pose since the last measured fix, and the position known then.
        waiting: Pings that wait for a position, in the order of their times.
        orientation: Last one of a message that is no ping, after its time [ns, UTC].
        frames: Frames by name of MAVLink pings that are not complete yet.
        components: By topic and the names of both, the component of a velocity that waits for the other.
        gps_fix_ns: Time of the last three-dimensional fix of each MAVLink system's GPS [ns, UTC]; None while it had none.
        dives: The way since the last fixes, for mean currents.
        bottom: Last velocity over the ground by a DVL, after its time [ns, UTC].
        track: Latest fixes at the surface.
        system: Number of the MAVLink system whose position and depth count: the one asked for, or the first that states a position.
    """

    fix: VehicleState | None = None
    depth: float = float("nan")
    dive: int = 0
    submerged: bool = False
    origins: Mapping[str, tuple[VehicleState, Pose]] = field(default_factory=dict)
    waiting: tuple[WaitingPing, ...] = ()
    orientation: tuple[int, Orientation] | None = None
    frames: Mapping[Key, Mapping[str, PingFrame]] = field(default_factory=dict)
    components: Mapping[tuple[str, str, str], Component] = field(default_factory=dict)
    gps_fix_ns: Mapping[str, int | None] = field(default_factory=dict)
    dives: Dives = field(default_factory=Dives)
    bottom: tuple[int, PlatformVelocity] | None = None
    track: Fixes = ()
    system: str | None = None

    @property
    def latitude(self) -> float | None:
        """Of the last position known [degrees north]; None before the first."""
        return None if self.fix is None else self.fix.latitude


#: The state after a message, and the events that it completes, among them pings that are still to be tested.
Step = tuple[MeasurementState, list[Event | PlacedPing]]


def at_depth(state: MeasurementState, depth: float, config: MeasurementConfig) -> MeasurementState:
    """Return the state with a depth noted; see ``is_submerged`` for where dives begin and end."""
    submerged, dives = (
        is_submerged(depth, config.surface_depth, state.submerged),
        record_depth(state.dives, depth),
    )
    if depth == state.depth and submerged == state.submerged and dives is state.dives:
        return state
    begun = submerged and not state.submerged
    return replace(state, depth=depth, submerged=submerged, dive=state.dive + begun, dives=dives)
