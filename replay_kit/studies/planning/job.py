"""What the study of planning is asked to do."""

import math
from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from replay_kit.core.errors import ConfigError
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
        samples: That a scenario plan is given.
        fresh: Samples that it is then flown through.
        allowed: Share of the samples that may trespass.
        masks: Random cases with islands and areas.
        replans: Missions planned anew at each surfacing.
        seed: Of everything that is drawn.
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
        unknown = [name for name in self.studies if name not in known]
        if unknown or not self.studies or len(set(self.studies)) < len(self.studies):
            raise ConfigError(f"--study: expected some of {', '.join(known)}, each once, got {', '.join(self.studies) or 'none'}")
        for name in ("pairs", "pings", "legs", "scenarios", "samples", "fresh", "masks", "replans"):
            if getattr(self, name) < 1:
                raise ConfigError(f"--{name}: expected a number above 0, got {getattr(self, name)}")
        if not (math.isfinite(self.noise) and self.noise > 0.0) or self.seed < 0:
            raise ConfigError(f"planning: expected --noise above 0 m/s and --seed of 0 or more, got {self.noise} and {self.seed}")

    def members(self, n_members: int) -> tuple[int, ...]:
        """Return the positions of the members left out in turn.

        Raises:
            ConfigError: They are no positions.
        """
        if self.leave_out is None:
            count = min(_TRUTHS, n_members, max(self.pairs, self.scenarios))
            return tuple(int(k) for k in (np.arange(count) + 0.5) * n_members / count)
        return members_named(self.leave_out, n_members)
