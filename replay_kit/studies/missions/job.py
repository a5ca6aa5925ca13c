"""The options of the studies on missions."""

from dataclasses import dataclass

from replay_kit.studies.jobs.checks import check_names, check_positive
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
        evaluations: How many times on the way the estimate is compared with the truth.
    """

    leave_out: str
    studies: tuple[str, ...] = STUDIES
    pings: int = 160
    days: float = 20.0
    dives: int = 30
    noise: float = 0.09
    seeds: int = 1
    evaluations: int = 20

    def check(self) -> None:
        """Raise ConfigError when an option is wrong."""
        check_names("--study", self.studies, STUDIES)
        check_positive(
            **{
                name: getattr(self, name)
                for name in ("pings", "dives", "seeds", "evaluations", "days", "noise")
            }
        )

    def members(self, n_members: int) -> tuple[int, ...]:
        """Return the positions of the members left out in turn.

        Raises:
            ConfigError: One is no position.
        """
        return members_named(self.leave_out, n_members)
