"""Simulated instruments that are wrong: faults put into the messages of a mission, and logs of such missions."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from replay_kit.core.geodesy import rotate_to_geographic, to_geographic
from replay_kit.core.grid import Ensemble, Projection
from replay_kit.core.message import Message
from replay_kit.core.observation import Reference
from replay_kit.logs.mcap.writer import write_mcap_log
from replay_kit.studies.twins.adcp import Flight, measured_on
from replay_kit.studies.twins.field import build_field
from replay_kit.studies.twins.glider import Schedule, mission
from replay_kit.studies.twins.make import Twin
from replay_kit.studies.twins.vehicle import EPOCH_NS, Pings

# draws of their own, so that a fault does not change what the instrument's noise draws
_PLATFORM_DRAWS = 1


@dataclass(frozen=True, slots=True)
class Faults:
    """How what is logged differs from the current over the ground with the instrument's noise.

    Attributes:
        reference: What the logged velocities are relative to.
        platform_std: Error of each component of the platform's velocity, which the pings then state [m/s]; None: they do not.
        heading_bias_deg: Added to the heading, clockwise: what is measured relative to the platform is turned by it.
    """

    reference: Reference = "earth"
    platform_std: float | None = None
    heading_bias_deg: float = 0.0


#: An instrument without faults.
SOUND = Faults()


def as_logged(
    velocity: np.ndarray, pings: Pings, projection: Projection, faults: Faults, seed: int
) -> tuple[np.ndarray, np.ndarray | None]:
    """Return velocities as the instrument logs them, and the platform's velocity that it states, shape (n, 2), or None.

    Args:
        velocity: shape (n, n_cells, 2) [m/s], of the water over the ground with noise, true east and north.
        pings: Where, and how the platform moved.
        projection: The local frame of the pings.
        faults: What is wrong.
        seed: Of the error of the platform's velocity.
    """
    if faults == SOUND:
        return velocity, None
    assert pings.velocity is not None, "missions know how their vehicle moves"
    longitude, latitude = to_geographic(projection, pings.east, pings.north)
    platform = np.column_stack(
        rotate_to_geographic(
            projection, longitude, latitude, pings.velocity[:, 0], pings.velocity[:, 1]
        )
    )
    bias = np.deg2rad(faults.heading_bias_deg)
    clockwise = np.array([[np.cos(bias), -np.sin(bias)], [np.sin(bias), np.cos(bias)]])
    logged = (velocity - platform[:, None]) @ clockwise
    if faults.reference == "earth":
        return logged + platform[:, None], None
    if faults.platform_std is None:
        return logged, None
    error = np.random.default_rng([seed, _PLATFORM_DRAWS]).standard_normal(platform.shape)
    return logged, platform + faults.platform_std * error


def messages_of(
    flight: Flight, faults: Faults = SOUND, seed: int = 0, *, pings: bool = True
) -> Iterator[Message]:
    """Yield the messages of a mission with the faults of its instrument.

    Args:
        flight: The mission.
        faults: What is wrong.
        seed: Of the error of the platform's velocity.
        pings: Whether its pings are logged.
    """
    track = flight.mission.pings
    logged, platform = as_logged(flight.measured, track, flight.field.grid.projection, faults, seed)
    found = replace(flight, measured=logged).messages()
    if not pings:
        found = (message for message in found if message.topic != "/adcp")
    for ordinal, message in enumerate(found):
        if message.topic == "/adcp":
            message.payload["reference"] = faults.reference
            if platform is not None:
                east, north = np.round(platform[message.payload["ping"]], 4).tolist()
                error = {"velocity_std": faults.platform_std, "source": "flight_model"}
                message.payload["platform_velocity"] = {"east": east, "north": north, **error}
        yield message._replace(position=ordinal)


def write_glider(
    truth: Ensemble, twin: Twin, out: Path, faults: Faults = SOUND, *, pings: bool = True
) -> None:
    """Write the log of a glider with faults; its positions are logged to the end of the last dive."""
    rng, field = np.random.default_rng(twin.seed), build_field(truth)
    start_ns = EPOCH_NS if truth.time_ns is None else truth.time_ns
    flown = mission(field, twin.pings, start_ns, rng, schedule=Schedule(to_the_end=True))
    flight = measured_on(flown, field, twin.noise, rng)
    write_mcap_log(out, messages_of(flight, faults, twin.seed, pings=pings))
