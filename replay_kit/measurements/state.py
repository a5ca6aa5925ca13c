"""What the measurement step remembers from one message to the next."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.message import Message
from replay_kit.core.observation import VehicleState
from replay_kit.measurements.current.mean import Dives, sunk
from replay_kit.measurements.ping import mavlink as mavlink_ping
from replay_kit.measurements.ping.attitude import Orientation
from replay_kit.measurements.ping.ground import GroundVelocity
from replay_kit.measurements.ping.waiting import WaitingPing
from replay_kit.measurements.vehicle import mavlink as mavlink_vehicle
from replay_kit.measurements.vehicle.position import Pose


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
        frames: Frames of MAVLink pings that are not complete yet.
        fixes: What the GPS of each MAVLink system last said.
        dives: The way since the last fixes, for mean currents.
        bottom: Last velocity over the ground by a DVL.
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
    frames: tuple[tuple[mavlink_ping.Key, dict[str, Message]], ...] = ()
    fixes: tuple[mavlink_vehicle.LastFix, ...] = ()
    dives: Dives = field(default_factory=Dives)
    bottom: GroundVelocity | None = None
    track: tuple[VehicleState, ...] = ()
    system: str | None = None

    @property
    def latitude(self) -> float | None:
        """Of the last position known [degrees north]; None before the first."""
        return None if self.fix is None else self.fix.latitude


def at_depth(state: MeasurementState, depth: float, config: MeasurementConfig) -> MeasurementState:
    """Return the state with a depth noted; a dive begins at twice the surface depth and ends above it."""
    submerged = depth > 2.0 * config.surface_depth or (state.submerged and depth > config.surface_depth)
    begun = submerged and not state.submerged
    return replace(state, depth=depth, submerged=submerged, dive=state.dive + begun, dives=sunk(state.dives, depth))
