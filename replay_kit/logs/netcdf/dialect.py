"""Dialect of columnar files: how its files are recognised, and the names and units of their contents.

Names are case-insensitive. The first name of a quantity in a file is read, after standard names.
"""

import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from replay_kit.core.message import NO_MEANS
from replay_kit.core.words.quantities import metres_per_second
from replay_kit.logs.netcdf.units import Quantity, quantity_of
from replay_kit.logs.netcdf.variables import NetcdfFile, Stored
from replay_kit.logs.payloads import Entry
from replay_kit.logs.reader import Entries

Names = Mapping[str, str]
# not at the surface, nor relative to the vehicle
_CURRENT = re.compile(r"(?:[a-z]+_)*?(eastward|northward)_sea_water_velocity(?:_\w+)?")
#: Variables that say how many samples each profile of a ragged array has, where no attribute does; and of which mission a file is.
SIZES, MISSIONS = ("rowsize", "row_size"), ("trajectory", "mission_name")


def flag_names(name: str) -> Sequence[str]:
    """Return the names under which the quality flags of a variable stand beside it."""
    return f"{name}_QC", f"{name}_qc"


#: Returns the messages of the files of one log, in a dialect; what is assumed is told to the files.
Read = Callable[[Sequence[NetcdfFile], "Dialect"], Entries]


@dataclass(frozen=True, slots=True)
class Dialect:
    """Convention of columnar files.

    Attributes:
        name: As in ``LogReport.format``.
        title: Description.
        signature: Names that all files of the dialect have; ``a|b`` is either.
        names: Quantity to its possible names in order of preference, separated by spaces. Those that end in ``time`` are times, in
            ``flag`` flags.
        convention: Text in the attribute ``Conventions`` that identifies the dialect; empty for none.
        standard: Quantity to the standard name that is tried before its names.
        quantities: Unit and bounds of quantities that differ from the usual ones.
        units: Unit of a quantity if files do not state it.
        flag_meanings: ``value meaning`` pairs of flags if files do not state them.
        heading: Reference of headings.
        beside: Pattern of further names that are read, in lower case.
        ascent_share: Position of a profile's own time and place in the dive, from 0 (start) to 1 (end); 0 if unknown.
        dac_kind: How the mean currents were computed.
        pings: Reads the pings of an ADCP from a file; None without an ADCP.
        log_of: Files of one log: each alone, those of one ``mission``, or ``all`` of the dialect.
        raw: Whether values are raw vehicle data: units are fixed, and positions before the first fix are unfounded.
        read: Reader of the columns; None for gliders.
        by_times: Whether a file may exceed memory: only its times are read when it is opened.
    """

    name: str
    title: str
    signature: str
    names: Names
    convention: str = ""
    standard: Names = field(default_factory=dict)
    quantities: Mapping[str, Quantity] = field(default_factory=dict)
    units: Names = field(default_factory=dict)
    flag_meanings: str = ""
    heading: Literal["magnetic", "true", "unknown"] = "unknown"
    beside: str = ""
    ascent_share: float = 0.0
    dac_kind: str = "dead_reckoning"
    pings: Callable[[NetcdfFile], Iterator[Entry]] | None = None
    log_of: Literal["file", "mission", "all"] = "file"
    raw: bool = False
    read: Read | None = None
    by_times: bool = False

    def recognises(self, names: Collection[str], attributes: Mapping[str, Any]) -> bool:
        """Return whether a file with these variables and attributes is of the dialect."""
        lower = {name.lower() for name in names}
        stated = str(attributes.get("Conventions", attributes.get("conventions", "")))
        if self.convention and self.convention in stated.upper():
            return True
        wanted = self.signature.split()
        return bool(wanted) and all(not lower.isdisjoint(each.split("|")) for each in wanted)

    def quantity_of(self, key: str) -> Quantity | None:
        """Return unit and bounds of a quantity; None for texts, flags and times."""
        return self.quantities.get(key) or quantity_of(key)

    def chosen(self, held: Mapping[str, Stored]) -> dict[str, str]:
        """Return the variable of each quantity of a file, in the file's case."""
        by_lower_case = {name.lower(): name for name in held}
        found = {}
        for key, listed in self.names.items():
            names = [by_lower_case[name] for name in listed.split() if name in by_lower_case]
            if standard := self.standard.get(key):
                stated = [name for name, one in held.items() if one.standard == standard]
                names = stated if len(stated) == 1 else names
            if names:
                found[key] = names[0]
        return found

    def wanted(self, held: Mapping[str, Stored]) -> list[str]:
        """Return the variables to read: those of quantities, their flags, and further ones."""
        found = self.chosen(held)
        chosen = set(found.values())
        if self.read is None and not {"dac_east", "dac_north"} <= found.keys():
            chosen |= {name for name, stored in held.items() if self._may_be_mean(name, stored)}
        chosen |= {flag for name in chosen for flag in flag_names(name)}
        always = (*SIZES, *MISSIONS)
        return [
            name
            for name in held
            if name in chosen or self._is_beside(name) or name.lower().startswith(always)
        ]

    def _is_beside(self, name: str) -> bool:
        return re.fullmatch(self.beside, name.lower()) is not None

    def _may_be_mean(self, name: str, stored: Stored) -> bool:
        """Return whether a variable may be a component of a mean current, by standard name or by a unit of velocity."""
        by_unit = not stored.standard and metres_per_second(stored.units) is not None
        return not self._is_beside(name) and (by_unit or bool(_direction(stored)))

    def by_standard_names(self, file: NetcdfFile) -> dict[str, str]:
        """Return the variable of each quantity of a file; components of currents by standard name if any has one.

        Conflicts of names and standard names, and possible mean currents, are noted.
        """
        held = file.variables
        found = self.chosen(held)
        for part in ("dac", "profile"):
            keys = (f"{part}_east", f"{part}_north")
            if not {*keys} <= found.keys():
                continue
            named = [found[key] for key in keys]
            stated = [_direction(held[name]) for name in named]
            if stated in (["north", "east"], ["north", ""], ["", "east"]):
                found |= dict(zip(keys, reversed(named), strict=True))
                how = "read as their standard names state, northward and eastward; their names state the opposite"
                file.note(f"{' and '.join(named)}: {how}")
            elif stated[0] == stated[1] != "":
                how = f"both have the standard name of the {stated[0]}ward component; read by their names"
                file.note(f"{' and '.join(named)}: {how}")
        if {"dac_east", "dac_north"} <= found.keys():
            return found
        free = {
            name: stored
            for name, stored in held.items()
            if name not in found.values()
            and stored.values.ndim < 2
            and self._may_be_mean(name, stored)
        }
        directed = {name: to for name, stored in free.items() if (to := _direction(stored))}
        sizes = {held[name].values.size for name in directed}
        if sorted(directed.values()) == ["east", "north"] and len(sizes) == 1:
            return found | {f"dac_{to}": name for name, to in directed.items()}
        if free:
            file.note(
                f"{NO_MEANS}{', '.join(free)} may be them, by their unit, but no standard name says which is east and which north; "
                "state eastward_sea_water_velocity and northward_sea_water_velocity"
            )
        return found


def _direction(stored: Stored) -> str:
    """Return ``east`` or ``north`` for a variable with the standard name of a current component; empty for others."""
    match = _CURRENT.fullmatch(stored.standard)
    return "" if match is None or match[0].startswith("surface") else match[1][:-4]
