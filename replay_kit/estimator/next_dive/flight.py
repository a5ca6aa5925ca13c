"""Flight-model error, inferred from the DACs of dives.

The speed may have a relative error. It is accepted only if the dives are e^2 times as likely with it as without, whichever single dive is
left out, as a wrong DAC, from a bad fix or entry, looks like such an error. The motion through water is displacement minus DAC: an error of
one DAC enters both with opposite signs, and dives on one heading would show a spurious error. Dives that differ by no more than such errors
therefore share the motion of the first of them, and only turns are informative.
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
# with other settings for an error than for none, chance among them alone is evidence of ten nats after 60 dives
_PROCESS = MeanCurrentProcess(ProcessSettings.paired(64), outliers=True)
# m/s; ways that differ by less may be one, each with the error of its mean current
_TURNED = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class FlightBias:
    """Estimate of the flight-model error after some dives.

    Attributes:
        known: k states, the first after all dives, the others after all but one; None before the first dive.
        way: shape (2,) [m/s], velocity through water of the first dive since the last turn; None before the first dive.
    """

    known: ProcessState | None = None
    way: Array | None = None

    @property
    def dives(self) -> int:
        """Number of dives."""
        return 0 if self.known is None else self.known.dives

    @property
    def evidence(self) -> float:
        """Log evidence for an error against none, without the most influential dive [nats]."""
        return float(_PROCESS.flight_evidence(self.known or _before()).min())

    @property
    def is_believed(self) -> bool:
        """Whether the dives show an error that does not rest on a single dive."""
        return self.evidence >= LEAST_EVIDENCE

    @property
    def share(self) -> tuple[Array, Array]:
        """Mean and standard deviation of the error along and across the motion, relative to it; shape (2,) each."""
        return _PROCESS.flight_bias(_sets(0, self.known or _before()))

    def after(self, dive: DiveMean) -> "FlightBias":
        """Return the estimate after one more dive."""
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
    """Return some of the sets of dives of states, along the leading axis; None adds the axis."""
    arrays = {
        name: np.concatenate([getattr(each, name) for each in (first, *others)])[chosen]
        for name in ("mean", "cov", "log_weights")
    }
    return replace(first, **arrays)
