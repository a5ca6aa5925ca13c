"""Small raw ADCP files with a known truth: Teledyne PD0 with bottom track and WinRiver's GPS, and bare Nortek records."""

import struct
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from itertools import accumulate
from pathlib import Path

import numpy as np

from replay_kit.core.message import Message
from replay_kit.logs import open_log
from tests.reference import frames as slow
from tests.reference.adcp_records import nortek_sum

FIRST_CELL, CELL, N_CELLS, ANGLE = 2.0, 1.0, 12, 20.0
START = datetime(2019, 6, 2, 4, 0, tzinfo=UTC)
CLOCK_BEHIND = timedelta(hours=8)  # the instrument runs on local time, a day earlier
LATITUDE, LONGITUDE = 48.0, -123.0
METRES_PER_DEGREE = 111_200.0
# of Teledyne, convex, towards the transducer
BEAMS = slow.janus_vectors(ANGLE)
_MISSING = -32768
_SYSTEMS = {"beam": 0, "instrument": 1, "ship": 2, "earth": 3}


@dataclass(frozen=True)
class Survey:
    """A vessel on a straight course over a current that is linear in depth; the heading is magnetic."""

    system: str = "beam"
    water: tuple[float, float, float] = (0.6, -0.3, 0.01)
    shear: tuple[float, float, float] = (0.0, 0.0, 0.0)
    vessel: tuple[float, float, float] = (1.5, 0.8, 0.0)
    heading: float = 70.0
    pitch: float = 6.0
    roll: float = -9.0
    declination: float = 15.8
    bottom_track: bool = True
    gps: bool = True
    stated_declination: float = 0.0
    bad_beam: int | None = None
    bottom: float = 50.0
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
    types += [_bottom_track(survey)] if survey.bottom_track else []
    types += [_gga(survey, k)] if survey.gps else []
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
    magnetic = (survey.heading - survey.declination) % 360.0
    attitude = (round(100 * magnetic), round(100 * survey.pitch), round(100 * survey.roll))
    part = struct.pack(
        "<HH7BBHHHHhhhh", 0x0080, k + 1, clock.year % 100, *rtc, 0, 0, 1500, 7, *attitude, 35, 1200
    )
    century = struct.pack("<BB7B", 0, 20, clock.year % 100, *rtc)
    return part + bytes(3 + 3 + 8) + struct.pack("<I2xII", 0, 0, 0) + century


def _rotation(survey: Survey) -> np.ndarray:
    return slow.teledyne(survey.heading, survey.pitch, survey.roll, survey.up)


def _in_system(survey: Survey, beams: np.ndarray) -> np.ndarray:
    """Return beam velocities, shape (4,), as the instrument would store them in its coordinate system."""
    if survey.system == "beam":
        return beams
    *own, error = slow.janus(beams, ANGLE, True)
    if survey.system == "instrument":
        return np.array([*own, error])
    off = survey.declination - survey.stated_declination
    turn = slow.about(2, survey.heading if survey.system == "ship" else off)
    return np.array([*(turn @ _rotation(survey) @ own), error])


def _velocity(survey: Survey) -> bytes:
    along = BEAMS @ _rotation(survey).T
    stretch = np.abs(along[:, 2]) / BEAMS[:, 2]
    rows = []
    for cell in range(survey.cells):
        distance = (FIRST_CELL + survey.cell * cell) * stretch[:, None]
        water = np.subtract(survey.water, survey.vessel) + distance * np.array(survey.shear)
        row = np.round(1000.0 * _in_system(survey, np.sum(along * water, axis=1)))
        if survey.bad_beam is not None and cell == 3:
            row[survey.bad_beam] = _MISSING
        rows.append(row)
    return struct.pack("<H", 0x0100) + np.array(rows).astype("<i2").tobytes()


def _bottom_track(survey: Survey) -> bytes:
    beams = -(BEAMS @ _rotation(survey).T) @ np.array(survey.vessel)
    velocity = np.round(1000.0 * _in_system(survey, beams)).astype("<i2").tobytes()
    distance = struct.pack("<H14x4H", 0x0600, *[round(100 * survey.bottom)] * 4)
    return distance + velocity + bytes([255] * 4 + [90] * 4 + [100] * 4) + bytes(41)


def _gga(survey: Survey, k: int) -> bytes:
    east, north = (speed * k / METRES_PER_DEGREE for speed in survey.vessel[:2])
    latitude = LATITUDE + north
    longitude = LONGITUDE + east / np.cos(np.deg2rad(LATITUDE))
    when = START + timedelta(seconds=k)
    position = struct.pack("<dcdc", latitude, b"N", -longitude, b"W")
    rest = struct.pack("<BBffcfcfH", 2, 8, 1.0, 0.0, b"M", 0.0, b"M", 0.0, 0)
    content = b"$GPGGA," + when.strftime("%H%M%S.00,").encode() + position + rest
    return struct.pack("<HHHd", 0x2022, 104, len(content) + 8, 0.0) + content
