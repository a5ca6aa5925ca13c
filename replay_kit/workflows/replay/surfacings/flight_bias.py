"""Correction of DACs for the flight-model error before assimilation.

A DAC is the distance of a surfacing from its dead-reckoned position over the dive's duration. A relative error of the flight model is thus
an error of the DAC: w (a + i b), with the velocity through the water w. An error estimated from earlier dives
(``estimator/next_dive/flight.py``) is subtracted, its uncertainty added to the observation error. A dive's own DAC and profiles contribute
from the next dive on.

Only profiles inverted from the dive's pings and DAC determine the flight model. Others are compared with uncorrected DACs to check the
instrument (``measurements/checks``): a rotated one would look like a flight-model error. A DAC with inverted profiles is not new to the
estimate: without a correction its error includes the remaining uncertainty of the flight model.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from replay_kit.core.arrays import Indices
from replay_kit.core.as_flown import FlightCorrection
from replay_kit.core.observation import PathMean, Profiles
from replay_kit.core.observation.block import Block
from replay_kit.estimator.next_dive.flight import FlightBias
from replay_kit.estimator.next_dive.process import DiveMean
from replay_kit.workflows.replay.surfacings.forecasts import Gathered, dive_mean

# Columns of profiles that tell of the flight model.
_OF_DIVE = "dive", "common_std", "depth", "velocity", "flags"


@dataclass(frozen=True, slots=True, eq=False)
class FlightState:
    """State of the flight-model correction.

    Attributes:
        bias: Flight-model error, from the dives so far.
        gathered: Profiles of the present dive.
    """

    bias: FlightBias = field(default_factory=FlightBias)
    gathered: Gathered = field(default_factory=Gathered)

    def correction(self, sizes: Sequence[float]) -> FlightCorrection | None:
        """Return the correction at the end of a log; None if no DAC was corrected.

        Args:
            sizes: Magnitude of the correction of each DAC [m/s].
        """
        if not sizes:
            return None
        (along, across), (along_std, across_std) = (part.tolist() for part in self.bias.share)
        return FlightCorrection(
            tuple(sizes), along, across, along_std, across_std, self.bias.dives, self.bias.evidence
        )


def corrected(state: FlightState, mean: PathMean) -> tuple[FlightState, PathMean]:
    """Return the state after a DAC, and the DAC, corrected if earlier dives determine a correction.

    A DAC without fixes or velocity through the water is unchanged.
    """
    if mean.fixes is None:
        return state, mean
    dive = dive_mean(state.gathered, mean, np.empty((0, 2)))
    if not mean.beside_profiles:
        # an instrument that is turned would look like a flight model that errs
        dive = replace(dive, inverted=None)
    return replace(state, bias=state.bias.after(dive)), _with_correction(mean, dive, state.bias)


def _with_correction(mean: PathMean, dive: DiveMean, bias: FlightBias) -> PathMean:
    """Return a DAC with the correction from earlier dives."""
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
    """Return the state after profiles of a block."""
    if not rows.size:
        return state
    profiles = Profiles({name: block.ping[name][rows] for name in _OF_DIVE}, block.topics)
    gathered = state.gathered.after(profiles)
    return state if gathered is state.gathered else replace(state, gathered=gathered)
