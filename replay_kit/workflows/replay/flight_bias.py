"""The flight model's error, taken from the mean currents before they are assimilated.

A mean current is how far the vehicle surfaced from where its flight model puts it, so an error of that model in proportion to the way
through the water is one of the mean current: w (a + i b). What the dives before say of a and b is subtracted, and how uncertain that is
increases the error. The dive's own mean current and profiles count from the next dive on: within the dive the estimate has them already.

Only profiles that an inversion made of the dive's pings and mean current tell of the flight model. Others are compared with the mean
currents as stated, to see whether the instrument is sound (``measurements/consistency``): one that is turned would look like a flight
model that errs.
"""

import math
from dataclasses import dataclass, field, replace

import numpy as np

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.observation import Observation, PathMean
from replay_kit.estimator.next_dive import DiveModel
from replay_kit.measurements import Event
from replay_kit.workflows.replay.dive_forecasts import ForecastState, dive_mean, with_profile

_MODEL = DiveModel.default()


@dataclass(frozen=True, slots=True, eq=False)
class FlightState:
    """What is known of the flight model.

    Attributes:
        known: Of the dives so far; outcomes and baselines are not kept.
    """

    known: ForecastState = field(default_factory=ForecastState)


def corrected(state: FlightState, mean: PathMean) -> tuple[FlightState, PathMean]:
    """Return the state after a mean current, and the mean current without what the dives before say of the flight model's error.

    One without fixes, whose way through the water is not known, or a drift at the surface, is returned as it is.
    """
    if mean.kind != "dac" or mean.fixes is None:
        return state, mean
    dive = dive_mean(state.known, mean, np.empty((0, 2)))
    if not mean.beside_profiles:
        # an instrument that is turned would look like a flight model that errs
        dive = replace(dive, inverted=None)
    before = _MODEL.initial() if state.known.model is None else state.known.model
    (along, across), std = _MODEL.flight_bias(before)
    east, north = dive.way
    error = complex(along, across) * complex(east, north)
    velocity = mean.velocity[0] - error.real, mean.velocity[1] - error.imag
    # of a way in any direction: the mean of both parts' variances
    error_std = math.hypot(
        mean.error_std, float(np.hypot(*dive.way)) * math.sqrt(float(np.mean(std**2)))
    )
    after = FlightState(replace(state.known, model=_MODEL.step(before, dive)))
    return after, replace(mean, velocity=velocity, error_std=error_std, stated=mean.velocity)


def as_used(
    state: FlightState, event: Event, config: MeasurementConfig
) -> tuple[FlightState, Event]:
    """Return the state after an event of the log, and the event as the estimate is given it."""
    if not config.flight_bias:
        return state, event
    if isinstance(event, PathMean):
        return corrected(state, event)
    return (
        (with_dive_profile(state, event), event)
        if isinstance(event, Observation)
        else (state, event)
    )


def with_dive_profile(state: FlightState, profile: Observation) -> FlightState:
    """Return the state after a profile of a dive."""
    known = with_profile(state.known, profile)
    return state if known is state.known else FlightState(known)
