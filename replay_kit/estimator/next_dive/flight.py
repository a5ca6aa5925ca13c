"""Inferred from dives' mean currents: the flight model's error, and the current beside the estimate.

**Flight model.** It may err in proportion to the way through the water. An error is believed only where the dives are e^2 times as likely
with one as without, whichever single dive is left out: a mean current that is wrong, by a bad fix or a wrong entry, is explained by such an
error as well as by anything, and would be taken from all others. The way itself is what the mean current leaves of the displacement, so an
error of one dive's mean current is in its way too, with the other sign: dives flown one way would show a flight model that errs by all of
it. So the way of dives that differ by no more than such errors is that of the first of them, and turns alone tell.

**Current beside the estimate.** The estimate's own error is part of what a dive's mean current may differ by, and one combination of
settings has no current beside the estimate: only what the estimate fails to explain, dive after dive, is evidence for one.
"""

from dataclasses import dataclass, replace

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.flow.local import LocalCurrent
from replay_kit.estimator.next_dive.filter import DiveMean, DiveModel, DiveState
from replay_kit.estimator.next_dive.mixtures import FLIGHT_WHITES, local_combinations

#: nats; least log evidence of an error over none.
LEAST_EVIDENCE = 2.0
# Dives that are left out at most: where there are more, those without which the evidence is least.
_MOST_LEFT_OUT = 8
_FLIGHT_MODEL = DiveModel.of_flight()
# m/s; ways that differ by less may be one, each with the error of its mean current
_TURNED = 2.5 * max(FLIGHT_WHITES)


@dataclass(frozen=True, slots=True, eq=False)
class FlightBias:
    """What is known of the flight model's error after some dives.

    Attributes:
        known: k states, of which the first is after all of them, the others after all but one; None before the first dive.
        way: shape (2,) [m/s], of the first dive since the last turn; None before the first dive.
    """

    known: DiveState | None = None
    way: Array | None = None

    @property
    def dives(self) -> int:
        """Number of dives."""
        return 0 if self.known is None else self.known.dives

    @property
    def evidence(self) -> float:
        """Log evidence of an error over none, without the dive on which it rests most [nats]."""
        return 0.0 if self.known is None else float(_FLIGHT_MODEL.flight_evidence(self.known).min())

    @property
    def is_believed(self) -> bool:
        """Whether the dives show an error, and no single one of them alone."""
        return self.evidence >= LEAST_EVIDENCE

    @property
    def share(self) -> tuple[Array, Array]:
        """Mean and standard deviation of the error along and across the way, as shares of it; shape (2,) each."""
        return _FLIGHT_MODEL.flight_bias(self.known or _FLIGHT_MODEL.initial())

    def after(self, dive: DiveMean) -> "FlightBias":
        """Return what is known after one more dive."""
        turned = self.way is None or np.hypot(*(dive.way - self.way)) > _TURNED
        way = dive.way if turned else self.way
        assert way is not None
        seen = _FLIGHT_MODEL.seen(self.known or _FLIGHT_MODEL.initial(), replace(dive, way=way))
        after, before = _FLIGHT_MODEL.after(seen), seen.state
        mean, cov, log_weights = (
            np.concatenate([getattr(after, name), getattr(before, name)[..., :1, :]], axis=-2)
            for name in ("mean", "cov", "log_weights")
        )
        known = replace(after, mean=mean, cov=cov, log_weights=log_weights)
        if len(log_weights) > 1 + _MOST_LEFT_OUT:
            evidence = _FLIGHT_MODEL.flight_evidence(known)[1:]
            least = [0, *1 + np.argsort(evidence, kind="stable")[:_MOST_LEFT_OUT]]
            known = replace(
                known, mean=mean[:, least], cov=cov[:, :, least], log_weights=log_weights[least]
            )
        return FlightBias(known, way)


_LOCAL_MODEL = DiveModel(local_combinations())
# Position among the unknowns of the part that decorrelates, to the east; to the north it is the next.
_LOCAL = 2


def local_step(state: DiveState | None, time_ns: int, innovation: Array, std: Array) -> DiveState:
    """Return the state after a dive.

    Args:
        state: After those before; None before the first.
        time_ns: Of the dive's middle [ns, UTC].
        innovation: shape (2,) [m/s], mean current minus that of the estimate before the dive, local axes.
        std: shape (2,) [m/s], of the innovation as the estimate and the measurement state it.
    """
    stated = float(np.sqrt(np.mean(std**2)))
    # an error of so many metres in a second is one of so many metres a second
    dive = DiveMean(time_ns, 1.0, np.zeros(2), 0.0, innovation, position_std=stated)
    return _LOCAL_MODEL.step(_LOCAL_MODEL.initial() if state is None else state, dive)


def local_current(state: DiveState | None) -> LocalCurrent | None:
    """Return the current beside the estimate after some dives; None before the first."""
    if state is None or state.time_ns is None:
        return None
    settings, part = _LOCAL_MODEL.settings, slice(_LOCAL, _LOCAL + 2)
    std, scale = np.sqrt(settings.variance[:, _LOCAL]), settings.scales[:, _LOCAL]
    return LocalCurrent(
        np.exp(state.log_weights[0]),
        std,
        scale,
        state.mean[part, 0].T,
        np.moveaxis(state.cov[part, part, 0], -1, 0),
        state.time_ns,
    )
