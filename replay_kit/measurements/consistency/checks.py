"""The checks of pings and of positions: to add one is to write its file and to name it here."""

from pkgutil import resolve_name
from typing import Protocol, Self

from replay_kit.core.errors import Finding
from replay_kit.core.observation import Observation, VehicleState
from replay_kit.measurements.consistency.summary import PingSummary


class PingCheck(Protocol):
    """What a check remembers of one instrument: a frozen value, made without arguments before the first ping."""

    def after(self, ping: Observation, summary: PingSummary) -> Self:
        """Return what is remembered after a ping that is neither dead nor stale.

        Args:
            ping: Of one topic.
            summary: What was computed of it for all checks.
        """
        ...

    def found(self, ping: Observation, named: frozenset[str]) -> Finding | None:
        """Return what the pings so far establish, if anything; of findings of one name the first is reported.

        Args:
            ping: The last one.
            named: Names of what was found of the instrument before.
        """
        ...


class PositionCheck(Protocol):
    """What a check remembers of the vehicle's positions: a frozen value, made without arguments before the first."""

    def after(self, vehicle: VehicleState) -> Self:
        """Return what is remembered after a position."""
        ...

    def found(self, vehicle: VehicleState, named: frozenset[str]) -> Finding | None:
        """Return what the positions so far establish, if anything; arguments as of a ``PingCheck``."""
        ...

    @property
    def is_unusable(self) -> bool:
        """Whether pings at the last position are not to be used."""
        ...


# Module and class, in the order in which findings are reported.
_OF_PINGS = (
    "geometry:DepthCounts",
    "speed_counts:SpeedCounts",
)
_OF_POSITIONS = ("geometry:PositionRun", "places:SeparatePlaces")
#: The checks before the first ping, and before the first position.
PING_CHECKS: tuple[PingCheck, ...] = tuple(
    resolve_name(f"{__package__}.{name}")() for name in _OF_PINGS
)
POSITION_CHECKS: tuple[PositionCheck, ...] = tuple(
    resolve_name(f"{__package__}.{name}")() for name in _OF_POSITIONS
)
