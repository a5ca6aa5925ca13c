"""Ensembles of a PD0 file grouped by the configuration in their leaders, and the reasons of unreadable ones.

MHKiT applies one configuration to all ensembles of a file. It is therefore called per configuration.

Source: Teledyne RD Instruments, "WorkHorse Commands and Output Data Format", PD0: header, fixed and variable leader.
"""

import struct
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

from replay_kit.logs.adcp.frames import Record

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


@dataclass(frozen=True, slots=True)
class Ensembles:
    """Readable ensembles of a file.

    Attributes:
        groups: Ordinals in the file of the ensembles of each configuration, increasing.
        parts: Bytes of the ensembles by ordinal.
        unreadable: Number of unreadable ensembles by reason.
        notes: Notes on changes of the configuration.
    """

    groups: Sequence[Sequence[int]]
    parts: Mapping[int, bytes]
    unreadable: Mapping[str, int]
    notes: tuple[str, ...]


def by_configuration(data: bytes, records: Sequence[Record]) -> Ensembles:
    """Return the ensembles of a file by configuration.

    Args:
        data: The file.
        records: Its valid ensembles.
    """
    groups = defaultdict[bytes, list[int]](list)
    parts: dict[int, bytes] = {}
    unreadable: Counter[str] = Counter()
    order: list[tuple[int, bytes]] = []
    for ordinal, record in enumerate(records):
        types = _types(data, record)
        if reason := _missing_types(types):
            unreadable[reason] += 1
            continue
        settings = b"".join(types[_FIXED][begin:end] for begin, end in _SETTINGS)
        groups[settings].append(ordinal)
        parts[ordinal] = data[record.start : record.end]
        order.append((ordinal, settings))
    changes = [k for (_, old), (k, new) in pairwise(order) if old != new]
    what = "the instrument's configuration changes, each ping uses its own: from ping"
    notes = (f"{what} {', '.join(map(str, changes[:_MOST_NOTED]))} on",) if changes else ()
    return Ensembles([*groups.values()], parts, unreadable, notes)


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
