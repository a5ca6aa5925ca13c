"""What a dialect of glider files is: how its files are recognised, and under which names they hold what.

A name is compared without regard to case. Of several names of a quantity the first that a file has is read.
"""

from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Literal

from replay_kit.logs.glider.netcdf import NetcdfFile
from replay_kit.logs.glider.units import (
    ANGLE,
    LATITUDE,
    LENGTH,
    LONGITUDE,
    NUMBER,
    PRESSURE,
    SPEED,
    Quantity,
)
from replay_kit.logs.reader import Entry

Names = Mapping[str, str]

#: What the reader asks for: samples along the track, fixes before (``start_``), after (``end_``) or at any time (``gps_``), mean
#: currents (``dac_``), absolute profiles (``profile_``). Times are read apart.
QUANTITIES: Mapping[str, Quantity] = MappingProxyType(
    {
        **{f"{part}longitude": LONGITUDE for part in ("", "gps_", "start_", "end_", "dac_")},
        **{f"{part}latitude": LATITUDE for part in ("", "gps_", "start_", "end_", "dac_")},
        **dict.fromkeys(("depth", "gps_error", "profile_depth"), LENGTH),
        "pressure": PRESSURE,
        **dict.fromkeys(("heading", "pitch", "roll", "declination"), ANGLE),
        **dict.fromkeys(
            ("dac_east", "dac_north", "dac_error", "profile_east", "profile_north"), SPEED
        ),
        **dict.fromkeys(("dive", "dead_reckoning", "nav_state"), NUMBER),
    }
)
TIMES = ("time", "gps_time", "start_time", "end_time", "dac_time")

# how many samples each profile of a ragged array has; which mission a file is of
_ALWAYS = ("rowsize", "row_size", "trajectory", "mission_name")


@dataclass(frozen=True, slots=True)
class Dialect:
    """One way of writing a glider's data.

    Attributes:
        name: As in ``LogReport.format``.
        title: For a person.
        signature: Names that a file of the dialect has, all of them; ``a|b`` is one of both.
        names: Quantity to the names that it may have, the preferred first, with spaces between them.
        convention: Text in the attribute ``Conventions`` that is enough to recognise the dialect; empty for none.
        units: Unit of a quantity where the dialect has one that the files do not state.
        flag_meanings: ``value meaning`` pairs of flags in files that do not state them.
        heading: What headings count from.
        beside: Prefixes of further names that the dialect's ADCP reader needs.
        ascent_share: Where in a dive a profile's own time and place lie, from 0 at its start to 1 at its end; 0 where that is not known.
        dac_kind: How the mean currents were computed.
        pings: Reads the pings of an ADCP from a file, and adds to the notes what it assumed; None for a dialect without one.
        in_parts: Whether a mission is many files: one a profile, or one a segment.
    """

    name: str
    title: str
    signature: str
    names: Names
    convention: str = ""
    units: Names = field(default_factory=dict)
    flag_meanings: str = ""
    heading: Literal["magnetic", "true", "unknown"] = "unknown"
    beside: tuple[str, ...] = ()
    ascent_share: float = 0.0
    dac_kind: str = "dead_reckoning"
    pings: Callable[[NetcdfFile, list[str]], Iterator[Entry]] | None = None
    in_parts: bool = False

    def recognises(self, names: Collection[str], attributes: Mapping[str, Any]) -> bool:
        """Return whether a file with these variables and attributes is of the dialect."""
        lower = {name.lower() for name in names}
        stated = str(attributes.get("Conventions", attributes.get("conventions", "")))
        by_name = all(
            any(name in lower for name in wanted.split("|")) for wanted in self.signature.split()
        )
        return (bool(self.convention) and self.convention in stated.upper()) or (
            bool(self.signature) and by_name
        )

    def chosen(self, names: Collection[str]) -> dict[str, str]:
        """Return the variable of each quantity that a file has: the first of its names, in the file's own case."""
        own = {name.lower(): name for name in names}
        found = {
            key: next((own[name] for name in listed.split() if name in own), "")
            for key, listed in self.names.items()
        }
        return {key: name for key, name in found.items() if name}

    def wanted(self, names: Collection[str]) -> list[str]:
        """Return which of a file's variables are read: those of quantities, their flags, and those of the ADCP reader."""
        chosen = set(self.chosen(names).values())
        flags = {name + suffix for name in chosen for suffix in ("_QC", "_qc")}
        beside = (*self.beside, *_ALWAYS)
        return [
            name
            for name in names
            if name in chosen or name in flags or name.lower().startswith(beside)
        ]
