"""Cases altered on purpose: fewer members, or a mean current whose strength the members agree on and the truth does not have.

A member is then its anomaly plus so many times the ensemble mean, the truth its own anomaly plus another number of times. The members
say nothing of how wrong the mean is, so that an estimator must expect it.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

from replay_kit.core.errors import ConfigError
from replay_kit.core.grid import Ensemble
from replay_kit.studies.twins.truths import Case


@dataclass(frozen=True, slots=True)
class Alteration:
    """What is done to an ensemble and its truth before a study.

    Attributes:
        every: Estimators are given every so many members, from the first.
        mean_factors: What the ensemble mean is multiplied by in the members, and in the truth.
    """

    every: int = 1
    mean_factors: tuple[float, float] = (1.0, 1.0)

    def check(self) -> None:
        """Raise ConfigError when an option is wrong."""
        if self.every < 1:
            raise ConfigError(f"--every: expected at least 1, got {self.every}")


#: An ensemble and its truth as they are.
AS_GIVEN = Alteration()


def altered_cases(
    ensemble: Ensemble, each: Iterable[Case], alteration: Alteration
) -> Iterator[Case]:
    """Yield cases after an alteration.

    Args:
        ensemble: All members; the mean is theirs.
        each: Truths, and the members that are left.
        alteration: What is done.

    Raises:
        ConfigError: Fewer than two members would be left.
    """
    if alteration == AS_GIVEN:
        yield from each
        return
    mean = ensemble.velocity.mean(axis=0)
    of_members, of_truth = ((factor - 1.0) * mean for factor in alteration.mean_factors)
    for case in each:
        kept = [
            member
            for member in range(0, ensemble.n_members, alteration.every)
            if member != case.member
        ]
        if len(kept) < 2:
            raise ConfigError(
                f"--every: expected a number that leaves at least 2 members, got {alteration.every}: {len(kept)} is left"
            )
        left = replace(ensemble, velocity=ensemble.velocity[kept] + of_members, members=())
        yield Case(case.member, replace(case.truth, velocity=case.truth.velocity + of_truth), left)
