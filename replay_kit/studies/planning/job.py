"""The options of the studies of planning."""

import math
from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from replay_kit.studies.jobs.checks import check_names, check_not_negative, check_positive
from replay_kit.studies.twins.truths import members_named

# Members that are the truth in turn when none are named.
_TRUTHS = 20


@dataclass(frozen=True, slots=True)
class PlanningJob:
    """Which studies, on which truths, of what size.

    Attributes:
        studies: Their names.
        leave_out: Positions of members from 0, with commas between them, or ``all``: each is the truth in turn; None for at most
            twenty, evenly spread.
        pairs: Starts and goals of glides and of missions, spread over the truths.
        pings: Given to each estimate.
        noise: Standard deviation of each component of each bin [m/s].
        legs: Of each mission.
        depth: Of a mission's dives, at most [m].
        scenarios: Missions planned for samples.
        samples: Of the estimate that a scenario plan is made for.
        fresh: Other samples that the plan is flown in.
        allowed: Share of the samples that may enter an area.
        masks: Random cases with islands and areas.
        replans: Missions replanned at each surfacing.
        seed: Of all random draws.
    """

    studies: tuple[str, ...]
    leave_out: str | None = None
    pairs: int = 100
    pings: int = 450
    noise: float = 0.09
    legs: int = 10
    depth: float = 500.0
    scenarios: int = 10
    samples: int = 20
    fresh: int = 500
    allowed: float = 0.1
    masks: int = 200
    replans: int = 40
    seed: int = 0

    def check(self, known: Collection[str]) -> None:
        """Raise ConfigError when an option is wrong."""
        check_names("--study", self.studies, known)
        counts = ("pairs", "pings", "legs", "scenarios", "samples", "fresh", "masks", "replans", "noise")
        check_positive(**{name: getattr(self, name) for name in counts})
        check_not_negative(seed=self.seed)

    @property
    def most_legs(self) -> int:
        """Limit on the legs of a replanned mission."""
        return math.ceil(1.5 * self.legs)

    def members(self, n_members: int) -> tuple[int, ...]:
        """Return the positions of the members left out in turn.

        Raises:
            ConfigError: They are no positions.
        """
        if self.leave_out is None:
            count = min(_TRUTHS, n_members, max(self.pairs, self.scenarios))
            return tuple(int(k) for k in (np.arange(count) + 0.5) * n_members / count)
        return members_named(self.leave_out, n_members)
