"""What is measured beside the vehicle's own currents: the water's temperature and salinity."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from replay_kit.measurements.messages.fields import number


@dataclass(frozen=True, slots=True)
class Ctd:
    """A sample of a CTD; NaN where it does not say.

    Attributes:
        depth: [m], positive down.
        temperature: In situ [degrees C].
        salinity: Practical.
        conductivity: [S/m].
        pressure: [dbar].
    """

    depth: float
    temperature: float
    salinity: float
    conductivity: float
    pressure: float


def ctd(payload: Mapping[str, Any]) -> Ctd:
    """Return the sample in a ``replay_kit.Ctd``."""
    names = ("depth", "temperature", "salinity", "conductivity", "pressure")
    return Ctd(*(number(payload.get(name)) for name in names))
