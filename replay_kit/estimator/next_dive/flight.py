"""The flight model's error, inferred from dives' mean currents.

Its speed may have a relative error. An error is believed only where the dives are e^2 times as likely with one as
without, whichever single dive is left out: a mean current that is wrong, by a bad fix or a wrong entry, is explained by such an error as
well as by anything, and would be taken from all others. The way itself is what the mean current leaves of the displacement, so an error of
one dive's mean current is in its way too, with the other sign: dives flown one way would show a flight model that errs by all of it. So the
way of dives that differ by no more than such errors is that of the first of them, and turns alone tell.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.estimator.next_dive.process import (
    DiveMean,
    MeanCurrentProcess,
    ProcessSettings,
    ProcessState,
)

#: nats; least log evidence of an error over none.
LEAST_EVIDENCE = 2.0
# Dives that are left out at most: where there are more, those without which the evidence is least.
_MOST_LEFT_OUT = 8
# evidence of 384 settings is the same within half a nat where there is any
_PROCESS = MeanCurrentProcess(ProcessSettings.drawn(128), outliers=True)
# m/s; ways that differ by less may be one, each with the error of its mean current
_TURNED = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class FlightBias:
    """What is known of the flight model's error after some dives.

    Attributes:
        known: k states, of which the first is after all of them, the others after all but one; None before the first dive.
        way: shape (2,) [m/s], of the first dive since the last turn; None before the first dive.
    """

    known: ProcessState | None = None
    way: Array | None = None

    @property
    def dives(self) -> int:
        """Number of dives."""
        return 0 if self.known is None else self.known.dives

    @property
    def evidence(self) -> float:
        """Log evidence of an error over none, without the dive on which it rests most [nats]."""
        return float(_PROCESS.flight_evidence(self.known or _before()).min())

    @property
    def is_believed(self) -> bool:
        """Whether the dives show an error, and no single one of them alone."""
        return self.evidence >= LEAST_EVIDENCE

    @property
    def share(self) -> tuple[Array, Array]:
        """Mean and standard deviation of the error along and across the way, as shares of it; shape (2,) each."""
        return _PROCESS.flight_bias(_sets(0, self.known or _before()))

    def after(self, dive: DiveMean) -> "FlightBias":
        """Return what is known after one more dive."""
        turned = self.way is None or np.hypot(*(dive.way - self.way)) > _TURNED
        way = dive.way if turned else self.way
        assert way is not None
        before, dive = self.known or _before(), replace(dive, way=way)
        without = _sets([0], _PROCESS.later(before, dive))
        known = _sets(slice(None), _PROCESS.step(before, dive), without)
        evidence = _PROCESS.flight_evidence(known)[1:]
        least = 1 + np.argsort(evidence, kind="stable")[:_MOST_LEFT_OUT]
        return FlightBias(_sets([0, *least], known), way)


def _before() -> ProcessState:
    return _sets(None, _PROCESS.initial())


def _sets(chosen: Any, first: ProcessState, *others: ProcessState) -> ProcessState:
    """Return some of the sets of dives of states, along the leading axis; None makes that of a state without."""
    arrays = {
        name: np.concatenate([getattr(each, name) for each in (first, *others)])[chosen]
        for name in ("mean", "cov", "log_weights")
    }
    return replace(first, **arrays)
