"""Small raw ADCP files of known numbers: Teledyne PD0 with bottom track and WinRiver's GPS, and bare Nortek records."""

import struct
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from itertools import accumulate
from pathlib import Path

import numpy as np

from replay_kit.core.message import Message
from replay_kit.logs import open_log
from tests.reference.adcp_records import nortek_sum

FIRST_CELL, CELL, N_CELLS, ANGLE = 2.0, 1.0, 12, 20.0
START = datetime(2019, 6, 2, 4, 0, tzinfo=UTC)
CLOCK_BEHIND = timedelta(hours=8)  # the instrument runs on local time, a day earlier
LATITUDE, LONGITUDE = 48.0, -123.0
METRES_PER_DEGREE = 111_200.0
#: Over the ground, east and north [m/s]; of the bottom, as it is stored [mm/s].
VESSEL, BOTTOM = (1.5, 0.8), (216, 36, 699, -446)
_MISSING = -32768
_SYSTEMS = {"beam": 0, "instrument": 1, "ship": 2, "earth": 3}


@dataclass(frozen=True)
class Survey:
    """A vessel on a straight course; the heading is magnetic."""

    system: str = "beam"
    heading: float = 54.2
    pitch: float = 6.0
    roll: float = -9.0
    bottom_track: bool = True
    gps: bool = True
    stated_declination: float = 0.0
    up: bool = False
    cells: int = N_CELLS
    cell: float = CELL
    leader: int | None = None  # bytes of the variable leader; None for all
    firmware: tuple[int, int] = (51, 40)
    profile: bool = True
    n: int = 30


def adcp_messages(path: Path) -> tuple[list[Message], list[Message]]:
    """Return a log's pings and fixes."""
    messages = list(open_log(path).messages())
    pings, fixes = ([m for m in messages if m.topic == at] for at in ("/adcp", "/vehicle/fix"))
    return pings, fixes


def pd0(survey: Survey) -> bytes:
    """Return a file of ``n`` ensembles, one a second."""
    return b"".join(ensemble(survey, k) for k in range(survey.n))


def ensemble(survey: Survey, k: int) -> bytes:
    """Return one ensemble with its checksum."""
    types = [_fixed_leader(survey), _variable_leader(survey, k)[: survey.leader]]
    if survey.profile:
        levels = ((0x0200, 128), (0x0300, 100), (0x0400, 100))
        values = (struct.pack("<H", of) + bytes([each]) * 4 * survey.cells for of, each in levels)
        types += [_velocity(survey), *values]
    types += [_bottom_track()] if survey.bottom_track else []
    types += [_gga(k)] if survey.gps else []
    *offsets, end = accumulate(map(len, types), initial=6 + 2 * len(types))
    header = struct.pack(f"<2sHBB{len(types)}H", b"\x7f\x7f", end + 2, 0, len(types), *offsets)
    body = header + b"".join(types) + b"\x00\x00"
    return body + struct.pack("<H", sum(body) & 0xFFFF)


def packet(kind: int, content: bytes) -> bytes:
    """Return a packet of another kind, 7F and its second byte, with its size and checksum."""
    body = bytes([0x7F, kind]) + struct.pack("<H", 4 + len(content)) + content
    return body + struct.pack("<H", sum(body) & 0xFFFF)


def nortek_record(kind: int, content: bytes, long: bool = False) -> bytes:
    """Return an AD2CP record with its two checksums."""
    size = struct.pack("<I" if long else "<H", len(content))
    head = (
        bytes([0xA5, 12 if long else 10, kind, 0x10])
        + size
        + struct.pack("<H", nortek_sum(content))
    )
    return head + struct.pack("<H", nortek_sum(head)) + content


def _fixed_leader(survey: Survey) -> bytes:
    turned = 0b111 if survey.system in ("ship", "earth") else 0b010
    system = 0b00001011 | (0x80 if survey.up else 0)
    head = struct.pack("<H9B", 0, *survey.firmware, system, 0x41, 0, 0, 4, survey.cells, 1)
    cell = round(100 * survey.cell)
    setup = struct.pack("<BHHBBBBH3B", 0, cell, 100, 1, 64, 5, 0, 2000, 0, 1, 0)
    coordinates = _SYSTEMS[survey.system] << 3 | turned, 0, round(100 * survey.stated_declination)
    sensors = 0b01111101, 0b00011101, int(100 * FIRST_CELL), 100, 1, 5, 50, 0, 20
    rest = struct.pack("<BhhBBHH2BBBH", *coordinates, *sensors)
    return head + setup + rest + bytes(8) + struct.pack("<HBBIB", 0, 255, 0, 1234, int(ANGLE))


def _variable_leader(survey: Survey, k: int) -> bytes:
    clock = START - CLOCK_BEHIND + timedelta(seconds=k)
    rtc = (clock.month, clock.day, clock.hour, clock.minute, clock.second, 0)
    attitude = (round(100 * each) for each in (survey.heading, survey.pitch, survey.roll))
    part = struct.pack(
        "<HH7BBHHHHhhhh", 0x0080, k + 1, clock.year % 100, *rtc, 0, 0, 1500, 7, *attitude, 35, 1200
    )
    century = struct.pack("<BB7B", 0, 20, clock.year % 100, *rtc)
    return part + bytes(3 + 3 + 8) + struct.pack("<I2xII", 0, 0, 0) + century


def velocity(survey: Survey) -> np.ndarray:
    """Return the velocities of the cells as they are stored [mm/s], one of them missing."""
    stored = 17 + 40 * np.arange(survey.cells)[:, None] - 150 * np.arange(4)
    stored[3, 2] = _MISSING
    return stored


def _velocity(survey: Survey) -> bytes:
    return struct.pack("<H", 0x0100) + velocity(survey).astype("<i2").tobytes()


def _bottom_track() -> bytes:
    distance = struct.pack("<H14x4H4h", 0x0600, *[5000] * 4, *BOTTOM)
    return distance + bytes([255] * 4 + [90] * 4 + [100] * 4) + bytes(41)


def _gga(k: int) -> bytes:
    east, north = (speed * k / METRES_PER_DEGREE for speed in VESSEL)
    latitude = LATITUDE + north
    longitude = LONGITUDE + east / np.cos(np.deg2rad(LATITUDE))
    when = START + timedelta(seconds=k)
    position = struct.pack("<dcdc", latitude, b"N", -longitude, b"W")
    rest = struct.pack("<BBffcfcfH", 2, 8, 1.0, 0.0, b"M", 0.0, b"M", 0.0, 0)
    content = b"$GPGGA," + when.strftime("%H%M%S.00,").encode() + position + rest
    return struct.pack("<HHHd", 0x2022, 104, len(content) + 8, 0.0) + content
