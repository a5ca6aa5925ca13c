"""Small DataFlash logs made in memory."""

import struct
from typing import Any

from replay_kit.logs.mavlink.dataflash import FMT, Format

_CODES = {
    **{"a": "32h", "n": "4s", "N": "16s", "Z": "64s", "M": "B", "g": "e"},
    **{"c": "h", "C": "H", "e": "i", "E": "I", "L": "i"},
}
# name, number, letters, columns
_DECLARED = """
GPS 133 QBBIHBcLLeffffB TimeUS,I,Status,GMS,GWk,NSats,HDop,Lat,Lng,Alt,Spd,GCrs,VZ,Yaw,U
POS 134 QLLfff TimeUS,Lat,Lng,Alt,RelHomeAlt,RelOriginAlt
CTUN 135 Qffc TimeUS,Alt,BAlt,CRt
IMU 136 QBffffff TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ
MSG 137 QZ TimeUS,Message
ISBD 138 QHa TimeUS,N,x
FILE 140 NIBZ FileName,Offset,Length,Data
MODE 141 QMBB TimeUS,Mode,ModeNum,Rsn
MIX 139 nNbBhHiIqQdgeEcC A,B,C,D,E,F,G,H,J,K,L,M,N,O,P,Q
"""
_TYPES = {
    name: (int(number), letters, columns)
    for name, number, letters, columns in map(str.split, _DECLARED.strip().splitlines())
}


def packing(letters: str) -> str:
    """The letters of ``struct`` for those of a format."""
    return "<" + "".join(_CODES.get(letter, letter) for letter in letters)


def form(name: str) -> Format:
    """The format of one of the kinds above."""
    number, letters, columns = _TYPES[name]
    length = 3 + struct.calcsize(packing(letters))
    return Format(number, name, length, letters, tuple(columns.split(",")))


def record(kind: Format, *values: Any) -> bytes:
    """A record: the values as they are stored, text as bytes."""
    return b"\xa3\x95" + bytes((kind.type,)) + struct.pack(packing(kind.letters), *values)


def declaration(kind: Format) -> bytes:
    """The FMT record of a kind."""
    texts = (text.encode() for text in (kind.name, kind.letters, ",".join(kind.columns)))
    return record(FMT, kind.type, kind.length, *texts)


def declarations() -> bytes:
    """The FMT records of all kinds, the first that of FMT itself."""
    return b"".join(declaration(kind) for kind in (FMT, *map(form, _TYPES)))


def gps(time_us: int, week_ms: int, week: int = 2300, status: int = 3) -> bytes:
    """A GPS record."""
    numbers = (475_000_000, -1246305732, 1234, 0.5, 12.0, -0.25, 0.0, 1)
    return record(form("GPS"), time_us, 0, status, week_ms, week, 11, 95, *numbers)


def dataflash(seconds: int) -> list[bytes]:
    """A log's declarations, then six records a second."""
    parts = [declarations()]
    for n in range(seconds):
        at = 265_000_000 + 1_000_000 * n
        parts += [
            gps(at, 300_000_000 + 1000 * n),
            record(form("POS"), at + 100, 475_000_000 + n, -1_246_305_732, -1.5, -1.5, -1.5),
            record(form("CTUN"), at + 90, -2.0 - n, -2.1, -12),
            record(form("IMU"), at + 200, n % 2, 0.1, -0.2, 0.3, 0.0, float("nan"), -9.8),
            record(form("MSG"), at + 300, b"dive \xe9" + str(n).encode()),
            record(form("ISBD"), at + 400, n, *range(-16, 16)),
        ]
    return parts
