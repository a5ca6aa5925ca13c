"""What the studies on missions are asked to do."""

import math
from dataclasses import dataclass

from replay_kit.core.errors import ConfigError
from replay_kit.studies.twins.truths import members_named

STUDIES = ("time", "relative", "dac", "outliers", "bias", "coverage")


@dataclass(frozen=True, slots=True)
class MissionJob:
    """Which studies, on which missions.

    Attributes:
        leave_out: Positions of members from 0, with commas between them, or ``all``: each is the truth in turn.
        studies: Of ``STUDIES``.
        pings: Of each mission.
        days: Over which the pings are spread; a changing truth ends it sooner.
        dives: Of the mission that has mean currents alone.
        noise: Standard deviation of each component of each bin [m/s].
        seeds: Seeds 0 to seeds - 1 are run for each truth.
        looks: How many times on the way the estimate is compared with the truth.
    """

    leave_out: str
    studies: tuple[str, ...] = STUDIES
    pings: int = 160
    days: float = 20.0
    dives: int = 30
    noise: float = 0.09
    seeds: int = 1
    looks: int = 20

    def check(self) -> None:
        """Raise ConfigError when an option is wrong."""
        unknown = [name for name in self.studies if name not in STUDIES]
        if unknown or not self.studies:
            raise ConfigError(f"--study: expected some of {', '.join(STUDIES)}, got {', '.join(self.studies) or 'none'}")
        if min(self.pings, self.dives, self.seeds, self.looks) < 1 or not (math.isfinite(self.days) and self.days > 0.0):
            raise ConfigError(
                f"missions: expected pings, dives, seeds and days above 0, got {self.pings}, {self.dives}, {self.seeds} and {self.days:g}"
            )
        if not (math.isfinite(self.noise) and self.noise > 0.0):
            raise ConfigError(f"--noise: expected an error above 0 m/s, got {self.noise}")

    def members(self, n_members: int) -> tuple[int, ...]:
        """Return the positions of the members left out in turn.

        Raises:
            ConfigError: One is no position.
        """
        return members_named(self.leave_out, n_members)
