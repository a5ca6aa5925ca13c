"""Ensembles of a PD0 file grouped by the configuration in their leaders, and the reasons of unreadable ones.

MHKiT applies one configuration to all ensembles of a file, and assumes the length of the variable leader from the firmware's number. It is
therefore called per configuration, with leaders of full length.

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
#: Length of a variable leader that every firmware fills at most, and where in it the clock with the century is [bytes].
_FULL_LEADER, _CENTURY = 66, 57
#: Least length of the leaders: up to the beams' first cell, and up to the temperature; and with the pressure [bytes].
_LEAST_FIXED, _LEAST_VARIABLE, _WITH_PRESSURE = 42, 28, 56
#: Where the fixed leader has what ensembles that are read together share [bytes]: firmware and system configuration, number of beams and
#: cells, cell size, coordinates (EX), alignment (EA), declination (EB), sensors and first cell, bandwidth.
_SETTINGS = ((2, 6), (8, 10), (12, 14), (25, 34), (58, 59))
#: Those bytes, and whether the variable leader includes the pressure.
Configuration = tuple[bytes, bool]


@dataclass(frozen=True, slots=True)
class Ensembles:
    """Readable ensembles of a file.

    Attributes:
        groups: Configuration to the ordinals of its ensembles in the file, increasing.
        parts: Bytes of the ensembles by ordinal, in the form that MHKiT needs.
        unreadable: Number of unreadable ensembles by reason.
        notes: Notes on changes of the configuration.
    """

    groups: Mapping[Configuration, Sequence[int]]
    parts: Mapping[int, bytes]
    unreadable: Mapping[str, int]
    notes: tuple[str, ...]


def by_configuration(data: bytes, records: Sequence[Record]) -> Ensembles:
    """Return the ensembles of a file by configuration.

    Args:
        data: The file.
        records: Its valid ensembles.
    """
    groups = defaultdict[Configuration, list[int]](list)
    parts: dict[int, bytes] = {}
    unreadable: Counter[str] = Counter()
    order: list[tuple[int, Configuration]] = []
    for ordinal, record in enumerate(records):
        types = _types(data, record)
        if reason := _missing_types(types):
            unreadable[reason] += 1
            continue
        configuration = _configuration(types[_FIXED], len(types[_VARIABLE]))
        groups[configuration].append(ordinal)
        parts[ordinal] = _with_full_leader(data[record.start : record.end], types[_VARIABLE])
        order.append((ordinal, configuration))
    changes = [k for (_, old), (k, new) in pairwise(order) if old != new]
    what = "the instrument's configuration changes, each ping uses its own: from ping"
    notes = (f"{what} {', '.join(map(str, changes[:_MOST_NOTED]))} on",) if changes else ()
    return Ensembles(groups, parts, unreadable, notes)


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


def _configuration(leader: bytes, variable_size: int) -> Configuration:
    """Return the configuration in a fixed leader: see ``_SETTINGS``."""
    settings = b"".join(leader[begin:end] for begin, end in _SETTINGS)
    return settings, variable_size >= _WITH_PRESSURE


def _with_full_leader(ensemble: bytes, leader: bytes) -> bytes:
    """Return an ensemble with its variable leader padded by zeros to full length, and the clock's century set."""
    missing = _FULL_LEADER - len(leader)
    if missing <= 0:
        return ensemble
    full = bytearray(leader + bytes(missing))
    if len(leader) < _CENTURY + 8:
        full[_CENTURY : _CENTURY + 8] = bytes([20 if leader[4] < 80 else 19]) + leader[4:11]
    count = ensemble[5]
    offsets = struct.unpack_from(f"<{count}H", ensemble, 6)
    place = next(at for at in offsets if ensemble[at : at + 2] == leader[:2])
    moved = [at + missing if at > place else at for at in offsets]
    head = struct.pack(
        f"<2sHBB{count}H", ensemble[:2], len(ensemble) - 2 + missing, ensemble[4], count, *moved
    )
    whole = head + ensemble[len(head) : place] + full + ensemble[place + len(leader) : -2]
    return whole + struct.pack("<H", sum(whole) & 0xFFFF)
