"""A glider's mission in a truth, and what an estimator is given of it: through the log's messages, as a replay has them."""

from collections.abc import Callable

import numpy as np

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.errors import ConfigError, ForecastError
from replay_kit.core.observation import Measurement
from replay_kit.measurements import observations
from replay_kit.studies.twins.adcp import SOUND, Faults
from replay_kit.studies.twins.field import Field
from replay_kit.studies.twins.glider import (
    STEP_S,
    SURFACE_STEPS,
    GliderLimits,
    Schedule,
    dive_steps,
    mission,
)
from replay_kit.studies.twins.messages import Flight, measured_on
from replay_kit.studies.twins.vehicle import EPOCH_NS, NS_PER_S, Mission

_USUAL = GliderLimits()
_DAY_S = 86_400.0
# a course begins at one of four corners, so that more attempts meet all of them
_ATTEMPTS = 10
_NEXT_SEED = 10_000


def staying(fly: Callable[[int], Flight], seed: int) -> Flight:
    """Return the first of some missions that stays in the truth's water: a course and noise for each seed, tried in a fixed order.

    Args:
        fly: Flies the mission of a seed.
        seed: The first seed.

    Raises:
        ForecastError: The current carried the glider out of the truth's water each time.
    """
    for attempt in range(_ATTEMPTS - 1):
        try:
            return fly(seed + _NEXT_SEED * attempt)
        except ForecastError:
            continue
    return fly(seed + _NEXT_SEED * (_ATTEMPTS - 1))


def dive_seconds(field: Field, limits: GliderLimits) -> float:
    """Return how long a dive and the stay at the surface after it take [s]."""
    return float(STEP_S * (dive_steps(field, limits) + SURFACE_STEPS))


def fly_pings(field: Field, pings: int, days: float, noise: float, seed: int) -> Flight:
    """Return a mission with its pings spread evenly over some days, from the truth's first time on.

    Args:
        field: The truth; one that changes ends the mission before its last time.
        pings: Number of pings.
        days: Over which they are spread.
        noise: [m/s].
        seed: Of the course and the noise.

    Raises:
        ConfigError: The pings do not fit into the time.
    """
    steps = int(pinging_seconds(field, days) / pings / STEP_S)
    if steps < 1:
        raise ConfigError(
            f"--pings: {pings} pings, {STEP_S} s apart at least, take longer than {days:g} days or the truth's time"
        )
    return _flown(
        field,
        noise,
        seed,
        lambda rng: mission(
            field, pings, _start_ns(field), rng, schedule=Schedule(steps, to_the_end=True)
        ),
    )


def pinging_seconds(field: Field, days: float) -> float:
    """Return for how long a mission of some days can ping [s]: in a truth that changes its last dive ends before the truth does."""
    if field.time_ns.size < 2:
        return days * _DAY_S
    end_s = float(field.time_ns[-1] - field.time_ns[0]) / NS_PER_S
    return min(days * _DAY_S, end_s - dive_seconds(field, _USUAL) - 2 * SURFACE_STEPS * STEP_S)


def fly_dives(field: Field, dives: int, noise: float, limits: GliderLimits, seed: int) -> Flight:
    """Return a mission of some dives; in a truth that changes it ends with the truth, where the forecast is least sure.

    Args:
        field: The truth.
        dives: Number of dives.
        noise: [m/s], of the pings, one in ten minutes.
        limits: How it dives.
        seed: Of the course and the noise.

    Raises:
        ConfigError: The dives take longer than the truth lasts.
    """
    seconds = dives * dive_seconds(field, limits) + SURFACE_STEPS * STEP_S
    start_ns = _start_ns(field)
    if field.time_ns.size > 1:
        start_ns = int(field.time_ns[-1]) - int(seconds) * NS_PER_S
        if start_ns < field.time_ns[0]:
            raise ConfigError(
                f"--dives: {dives} dives take {seconds / _DAY_S:.1f} days, longer than the truth's time"
            )
    steps = 5
    # the last ping is in the last dive
    pings = int((seconds - 0.5 * dive_seconds(field, limits)) / (steps * STEP_S))
    return _flown(
        field,
        noise,
        seed,
        lambda rng: mission(field, pings, start_ns, rng, limits, Schedule(steps, to_the_end=True)),
    )


def measurements(
    flight: Flight, faults: Faults = SOUND, *, pings: bool = True, mean_currents: bool = False
) -> tuple[Measurement, ...]:
    """Return what an estimator is given of a mission.

    Args:
        flight: The mission.
        faults: What the instrument gets wrong, or does not know.
        pings: Whether its pings are logged.
        mean_currents: Whether the dives' mean currents are used.
    """
    return tuple(
        observations(
            flight.messages(faults, pings=pings),
            MeasurementConfig(without=() if mean_currents else ("dac",)),
        )
    )


def _start_ns(field: Field) -> int:
    return int(field.time_ns[0]) or EPOCH_NS


def _flown(
    field: Field, noise: float, seed: int, fly: Callable[[np.random.Generator], Mission]
) -> Flight:
    """Return a mission with what its instrument measures, both from one stream of random numbers."""
    rng = np.random.default_rng(seed)
    return measured_on(fly(rng), field, noise, rng, seed)
