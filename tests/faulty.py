"""Simulated instruments that are wrong: faults put into the messages of a mission, and logs of such missions."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from replay_kit.core.geodesy import rotate_to_geographic, to_geographic
from replay_kit.core.grid import Ensemble
from replay_kit.core.message import Message
from replay_kit.core.observation import Reference
from replay_kit.logs.mcap.writer import write_mcap_log
from replay_kit.studies.twins.field import Field, build_field
from replay_kit.studies.twins.make import Twin, measure, messages
from replay_kit.studies.twins.mission import GLIDER_SPEED, VESSEL_SPEED, Mission, dives

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


@dataclass(frozen=True, slots=True, eq=False)
class Flight:
    """A mission, the current that it is in, and what its sound instrument measures, shape (pings, n_cells, 2) [m/s]."""

    mission: Mission
    field: Field
    noise: float
    measured: np.ndarray


def measured_on(mission: Mission, field: Field, noise: float, rng: np.random.Generator) -> Flight:
    """Return a mission with its measurements."""
    return Flight(mission, field, noise, measure(field, mission.place[mission.pinged], noise, rng))


def platform_velocity(mission: Mission, field: Field) -> np.ndarray:
    """Return the velocity of the vehicle over the ground at each ping, shape (n, 2) [m/s], true east and north."""
    at = mission.pinged
    heading, pitch = (np.deg2rad(each[at]) for each in (mission.heading_deg, mission.pitch_deg))
    ahead = np.column_stack([np.sin(heading), np.cos(heading)])
    east, north, depth = mission.place[at].T
    where = to_geographic(field.grid.projection, east, north)
    own = np.where(pitch == 0.0, 0.0, GLIDER_SPEED * np.cos(pitch))[:, None] * ahead
    # a vessel's course is along the local axes
    local = field.velocity(east, north, depth) if len(mission.dives) else VESSEL_SPEED * ahead
    return own + np.column_stack(rotate_to_geographic(field.grid.projection, *where, *local.T))


def as_logged(flight: Flight, faults: Faults, seed: int) -> tuple[np.ndarray, np.ndarray | None]:
    """Return velocities as the instrument logs them, and the platform's velocity that it states, shape (n, 2), or None.

    Args:
        flight: The mission with sound measurements.
        faults: What is wrong.
        seed: Of the error of the platform's velocity.
    """
    if faults == SOUND:
        return flight.measured, None
    platform = platform_velocity(flight.mission, flight.field)
    bias = np.deg2rad(faults.heading_bias_deg)
    clockwise = np.array([[np.cos(bias), -np.sin(bias)], [np.sin(bias), np.cos(bias)]])
    logged = (flight.measured - platform[:, None]) @ clockwise
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
    logged, platform = as_logged(flight, faults, seed)
    found = messages(flight.mission, logged, flight.noise)
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
    """Write the log of a glider with faults."""
    rng, field = np.random.default_rng(twin.seed), build_field(truth)
    flight = measured_on(dives(field, twin.pings, rng), field, twin.noise, rng)
    write_mcap_log(out, messages_of(flight, faults, twin.seed, pings=pings))
