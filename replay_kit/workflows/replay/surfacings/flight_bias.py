"""The flight model's error, taken from the mean currents before they are assimilated.

A mean current is how far the vehicle surfaced from where its flight model puts it, so an error of that model in proportion to the way
through the water is one of the mean current: w (a + i b). Where the dives before show one (``estimator/next_dive/flight.py``), it is
subtracted, and how uncertain it is increases the error. What was measured stays beside it. The dive's own mean current and profiles count
from the next dive on: within the dive the estimate has them already.

Only profiles that an inversion made of the dive's pings and mean current tell of the flight model. Others are compared with the mean
currents as stated, to see whether the instrument is sound (``measurements/checks``): one that is turned would look like a flight
model that errs. A mean current beside inverted profiles is not new to the estimate: until a correction is known, its error includes that
of the flight model, as far as the dives before leave it open.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from replay_kit.core.arrays import Indices
from replay_kit.core.as_flown import FlightCorrection
from replay_kit.core.block import Block
from replay_kit.core.observation import PathMean, Profiles
from replay_kit.estimator.next_dive.flight import FlightBias
from replay_kit.estimator.next_dive.process import DiveMean
from replay_kit.workflows.replay.surfacings.forecasts import Gathered, dive_mean

# Columns of profiles that tell of the flight model.
_OF_DIVE = "dive", "common_std", "depth", "velocity", "flags"


@dataclass(frozen=True, slots=True, eq=False)
class FlightState:
    """What is known of the flight model.

    Attributes:
        bias: Its error, from the dives so far.
        gathered: Profiles of the dive.
    """

    bias: FlightBias = field(default_factory=FlightBias)
    gathered: Gathered = field(default_factory=Gathered)

    def correction(self, sizes: Sequence[float]) -> FlightCorrection | None:
        """Return the correction at the end of a log; None where no mean current was corrected.

        Args:
            sizes: Length of what was taken from each mean current [m/s].
        """
        if not sizes:
            return None
        (along, across), (along_std, across_std) = (part.tolist() for part in self.bias.share)
        return FlightCorrection(
            tuple(sizes), along, across, along_std, across_std, self.bias.dives, self.bias.evidence
        )


def corrected(state: FlightState, mean: PathMean) -> tuple[FlightState, PathMean]:
    """Return the state after a mean current, and the mean current with its correction, if the dives before show one.

    One without fixes, whose way through the water is not known, or a drift at the surface, is returned as it is.
    """
    if mean.kind != "dac" or mean.fixes is None:
        return state, mean
    dive = dive_mean(state.gathered, mean, np.empty((0, 2)))
    if not mean.beside_profiles:
        # an instrument that is turned would look like a flight model that errs
        dive = replace(dive, inverted=None)
    return replace(state, bias=state.bias.after(dive)), _with_correction(mean, dive, state.bias)


def _with_correction(mean: PathMean, dive: DiveMean, bias: FlightBias) -> PathMean:
    """Return a mean current with the correction by what the dives before say of the flight model."""
    believed = bias.is_believed
    if not (believed or mean.beside_profiles):
        return mean
    share, std = bias.share
    velocity = None
    if believed:
        error = complex(*share) * complex(*dive.way)
        velocity = mean.velocity[0] - error.real, mean.velocity[1] - error.imag
    else:
        std = np.hypot(share, std)
    # of a way in any direction: the mean of both parts' variances
    flight_std = float(np.hypot(*dive.way)) * math.sqrt(float(np.mean(std**2)))
    return replace(mean, corrected=velocity, flight_std=flight_std)


def with_block(state: FlightState, block: Block, rows: Indices) -> FlightState:
    """Return the state after some profiles of a block."""
    if not rows.size:
        return state
    profiles = Profiles({name: block.ping[name][rows] for name in _OF_DIVE}, block.topics)
    gathered = state.gathered.after(profiles)
    return state if gathered is state.gathered else replace(state, gathered=gathered)
