"""Whether a flight model errs in proportion to the way through the water, by how much, and on how many dives that rests.

An error is believed only where the dives are e^2 times as likely with one as without, whichever single dive is left out: a mean current
that is wrong, by a bad fix or a wrong entry, is explained by such an error as well as by anything, and would be taken from all others.
"""

from dataclasses import dataclass

from replay_kit.core.arrays import Array
from replay_kit.estimator.next_dive.filter import DiveMean, DiveModel, DiveState

#: nats; least log evidence of an error over none.
LEAST_EVIDENCE = 2.0
# Dives that are left out at most: where there are more, those without which the evidence is least.
_MOST_LEFT_OUT = 32
_MODEL = DiveModel.of_flight()


@dataclass(frozen=True, slots=True, eq=False)
class FlightBias:
    """What is known of the flight model's error after some dives.

    Attributes:
        known: Of all of them; None before the first, as it is large.
        without: Of all but one, a state for each dive that is left out.
    """

    known: DiveState | None = None
    without: tuple[DiveState, ...] = ()

    @property
    def dives(self) -> int:
        """Number of dives."""
        return 0 if self.known is None else self.known.dives

    @property
    def evidence(self) -> float:
        """Log evidence of an error over none, without the dive on which it rests most [nats]."""
        states = self.without if self.known is None else (self.known, *self.without)
        return min(map(_MODEL.flight_evidence, states), default=0.0)

    @property
    def is_believed(self) -> bool:
        """Whether the dives show an error, and no single one of them alone."""
        return self.evidence >= LEAST_EVIDENCE

    @property
    def share(self) -> tuple[Array, Array]:
        """Mean and standard deviation of the error along and across the way, as shares of it; shape (2,) each."""
        return _MODEL.flight_bias(_MODEL.initial() if self.known is None else self.known)

    def after(self, dive: DiveMean) -> "FlightBias":
        """Return what is known after one more dive."""
        before = _MODEL.initial() if self.known is None else self.known
        without = [*(_MODEL.step(state, dive) for state in self.without), before]
        return FlightBias(
            _MODEL.step(before, dive),
            tuple(sorted(without, key=_MODEL.flight_evidence)[:_MOST_LEFT_OUT]),
        )
