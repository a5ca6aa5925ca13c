"""Ensembles of a PD0 file grouped by the configuration in their leaders, and the reasons of unreadable ones.

MHKiT applies one configuration to all ensembles of a file. It is therefore called per configuration.

Source: Teledyne RD Instruments, "WorkHorse Commands and Output Data Format", PD0: header, fixed and variable leader.
"""

import struct
from collections import defaultdict
from collections.abc import Mapping, Sequence
from itertools import pairwise

from replay_kit.logs.adcp.frames import Record
from replay_kit.logs.reader import Told

#: Topic of the pings.
PINGS = "/adcp"
_FIXED, _VARIABLE = 0x0000, 0x0080
#: Blocks with a number for each cell and beam: the bytes of one.
_BLOCKS = {0x0100: 2, 0x0200: 1, 0x0300: 1, 0x0400: 1}
_BEAMS = 4
#: Changes of the configuration that are told.
_MOST_NOTED = 9
#: Least length of the leaders: up to the beams' first cell, and up to the clock with the century, which instruments before 2000 lack.
_LEAST_FIXED, _LEAST_VARIABLE = 42, 65
#: Where the fixed leader has what ensembles that are read together share [bytes]: firmware and system configuration, number of beams and
#: cells, cell size, coordinates (EX), alignment (EA), declination (EB), sensors and first cell, bandwidth.
_SETTINGS = ((2, 6), (8, 10), (12, 14), (25, 34), (58, 59))


#: Ordinal in the file, and bytes, of each ensemble of a configuration.
Group = list[tuple[int, bytes]]


def by_configuration(data: bytes, records: Sequence[Record], told: Told) -> list[Group]:
    """Return the ensembles of a file that can be read, by configuration.

    Args:
        data: The file.
        records: Its valid ensembles.
        told: Receives changes of the configuration, and counts of unreadable ensembles.
    """
    groups = defaultdict[bytes, Group](list)
    latest, changes = b"", list[str]()
    for ordinal, record in enumerate(records):
        types = _types(data, record)
        if reason := _missing_types(types):
            told.skipped[PINGS, reason] += 1
            continue
        settings = b"".join(types[_FIXED][begin:end] for begin, end in _SETTINGS)
        groups[settings].append((ordinal, data[record.start : record.end]))
        changes += [str(ordinal)] * (latest not in (b"", settings))
        latest = settings
    if changes:
        what = "the instrument's configuration changes, each ping uses its own: from ping"
        told.notes.append(f"{what} {', '.join(changes[:_MOST_NOTED])} on")
    return [*groups.values()]


def _types(data: bytes, record: Record) -> dict[int, bytes]:
    """Return the data types of an ensemble by identifier, each up to the start of the next."""
    count = data[record.start + 5]
    offsets = sorted(
        {*struct.unpack_from(f"<{count}H", data, record.start + 6), record.end - 2 - record.start}
    )
    pieces = [
        data[record.start + begin : record.start + end]
        for begin, end in pairwise(offsets)
        if end <= record.end - 2 - record.start
    ]
    # of two blocks of one kind, as WinRiver's positions, none is of use here
    return {
        struct.unpack_from("<H", piece)[0]: piece for piece in reversed(pieces) if len(piece) >= 2
    }


def _missing_types(types: Mapping[int, bytes]) -> str:
    """Return the missing data types of an ensemble as text; empty if complete."""
    # a narrow-band instrument's first profile has other identifiers; MHKiT knows them
    if _FIXED not in types:
        return "ensemble without the fixed leader of a first profile"
    for name, kind, least in (
        ("fixed leader", _FIXED, _LEAST_FIXED),
        ("variable leader", _VARIABLE, _LEAST_VARIABLE),
    ):
        if (size := len(types.get(kind, b""))) < least:
            return f"ensemble whose {name} has {size} bytes, {least} are needed (clock, attitude, cells)"
    cells = types[_FIXED][9]
    for kind, width in _BLOCKS.items():
        if kind in types and len(types[kind]) < 2 + _BEAMS * cells * width:
            return (
                f"ensemble whose block {kind:#06x} has {len(types[kind])} bytes, "
                f"{2 + _BEAMS * cells * width} are needed for {cells} cells"
            )
    return ""
