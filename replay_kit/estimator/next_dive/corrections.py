"""Corrections inferred from the DACs of dives: the flight-model error, and a local correction of the estimate."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from replay_kit.core.arrays import Array, replace
from replay_kit.core.flow.local import LocalCurrent
from replay_kit.estimator.next_dive.mixture import log_densities
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
# m/s and s: long-run deviations of the processes, each with each decorrelation time; with even odds there is no such current
_STDS = np.repeat([0.0, 0.02, 0.04, 0.08, 0.16], 3)
_NO_CORRECTION = LocalCurrent(
    np.where(_STDS > 0.0, 1.0 / 24.0, 1.0 / 6.0),
    _STDS,
    np.tile([21_600.0, 86_400.0, 345_600.0], 5),
    np.zeros((15, 2)),
    _STDS[:, None, None] ** 2 * np.eye(2),
    0,
)
# m/s; of a component, what no other dive shares beside the stated error
_WHITE_STD = 0.005
# Probability of a change by more than usual, and what it adds to the variances, as a multiple of those in the long run.
_JUMP, _JUMP_FACTOR = 0.05, 3.0


@dataclass(frozen=True, slots=True, eq=False)
class FlightBias:
    """Estimate of the flight-model error after some dives.

    The speed may have a relative error, accepted if the dives are e^2 times as likely with it, whichever one is left out: a wrong DAC
    looks like one. Motion through water is displacement minus DAC, so an error of a DAC enters both: dives that differ by no
    more share the motion of the first, and only turns are informative.

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


def local_step(
    state: LocalCurrent | None, time_ns: int, innovation: Array, std: Array
) -> LocalCurrent:
    """Return the local correction after a dive.

    The innovation includes the estimate's error; one of the processes has no correction. With some probability the correction jumps
    between dives; both cases are merged to one Gaussian per process (Blom and Bar-Shalom 1988, IEEE TAC 33).

    Args:
        state: Correction before it; None before the first.
        time_ns: Middle of the dive [ns, UTC].
        innovation: shape (2,) [m/s], DAC minus that of the estimate before the dive, local axes.
        std: shape (2,) [m/s], stated standard deviation of the innovation.
    """
    now = (state or _NO_CORRECTION).at(time_ns)
    more = np.array([0.0, _JUMP_FACTOR])[:, None, None, None] * now.std[:, None, None] ** 2
    covs, errors = now.cov + more * np.eye(2), innovation - now.mean
    spreads = covs + (np.mean(std**2) + _WHITE_STD**2) * np.eye(2)
    gains = covs @ np.linalg.inv(spreads)
    log_each = np.log([[1.0 - _JUMP], [_JUMP]]) + log_densities(errors, spreads)
    total = np.logaddexp.reduce(log_each, axis=0)
    shares = np.exp(log_each - total)[..., None]
    moves = (gains @ errors[:, :, None])[..., 0]
    move = np.sum(shares * moves, axis=0)
    about = (moves - move)[..., None]
    cov = covs - gains @ covs + about @ about.swapaxes(-1, -2)
    # one that rounding has made impossible may become likely again
    log_weights = np.log(now.probability + 1e-300) + total
    return replace(
        now,
        probability=np.exp(log_weights - np.logaddexp.reduce(log_weights)),
        mean=now.mean + move,
        cov=np.sum(shares[..., None] * cov, axis=0),
    )
