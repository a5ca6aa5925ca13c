"""Checks that are added as the README says: a class in a list, and what it finds leaves measurements out."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from replay_kit.core.errors import Finding
from replay_kit.core.observation import Observation, Reason, VehicleState
from replay_kit.measurements.consistency import checks
from replay_kit.measurements.consistency.summary import PingSummary
from tests.measurements.samples import checked, profile, vehicle


@dataclass(frozen=True, slots=True)
class Repeated:
    """Pings of one time: two are a clock that stands still."""

    last_ns: int = -1
    count: int = 0

    def after(self, ping: Observation, summary: PingSummary) -> Self:
        """Return the count after a ping."""
        return type(self)(ping.time_ns, self.count + 1 if ping.time_ns == self.last_ns else 0)

    def found(self, ping: Observation, named: frozenset[str]) -> Finding | None:
        """Return that the clock stands."""
        return (
            Finding("clock", ping.time_ns, f"{self.count}", "a clock", "mend it", distrusts=True)
            if self.count
            else None
        )


@dataclass(frozen=True, slots=True)
class North:
    """Positions beyond a pole."""

    is_unusable: bool = False

    def after(self, vehicle: VehicleState) -> Self:
        """Return whether the position is one."""
        return type(self)(vehicle.latitude > 90.0)

    def found(self, vehicle: VehicleState, named: frozenset[str]) -> Finding | None:
        """Return that it is."""
        return Finding("pole", vehicle.time_ns, "", "", "") if self.is_unusable else None


def _ping(time_ns: int) -> Observation:
    velocity = np.random.default_rng(time_ns).normal(0.0, 0.1, (3, 2))
    return profile(velocity, [10.0, 20.0, 30.0], time_ns=time_ns)


def test_an_added_check_of_pings_is_told_once_and_its_instrument_not_used(
    monkeypatch,
):
    events = [_ping(1), _ping(1), _ping(1), _ping(2)]
    assert "clock" not in {finding.name for finding in checked(events)[0].findings}
    monkeypatch.setattr(checks, "PING_CHECKS", (Repeated(),))
    state, out, _ = checked(events)
    assert [(finding.name, finding.evidence) for finding in state.findings] == [("clock", "1")]
    used = [event.reasons.tolist() for event in out if isinstance(event, Observation)]
    assert used == [[0, 0, 0], *[[Reason.INCONSISTENT] * 3] * 3]


def test_an_added_check_of_positions_leaves_the_pings_at_them_out(
    monkeypatch,
):
    latitudes = (10.0, 91.0, 92.0, 20.0)
    places = [vehicle(1e-9 * k, latitude=latitude) for k, latitude in enumerate(latitudes)]
    events = [event for place in places for event in (place, _ping(place.time_ns))]
    monkeypatch.setattr(checks, "POSITION_CHECKS", (North(),))
    state, out, _ = checked(events)
    assert [(finding.name, finding.since_ns) for finding in state.findings] == [("pole", 1)]
    assert [bool(event.reasons.any()) for event in out if isinstance(event, Observation)] == [
        False,
        True,
        True,
        False,
    ]
