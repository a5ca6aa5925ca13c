"""Small Nortek AD2CP files of known velocities: bursts in beam, instrument or earth coordinates, and bottom tracks between them."""

import struct
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

import numpy as np

from tests.logs.adcp.raw_adcp_samples import nortek_record

START = datetime(2024, 5, 1, 6, 30, tzinfo=UTC)
ANGLE, N_CELLS, CELL, BLANK = 25.0, 6, 1.0, 0.5
SYSTEMS = ("earth", "instrument", "beam")
TEXT, BURST, BOTTOM = 0xA0, 0x15, 0x17


@dataclass(frozen=True)
class Survey:
    """Velocities of water and bottom along the instrument's axes [m/s]; the heading is true, as DECL is stated."""

    system: str = "beam"
    bottom_system: str = "beam"
    water: tuple[float, float, float] = (0.7, -0.9, 0.05)
    bottom: tuple[float, float, float] = (-1.1, 0.7, 0.2)
    heading: float = 70.0
    pitch: float = 5.0
    roll: float = -8.0
    down: bool = True
    distance_mm: tuple[int, ...] = (30_000, 31_000, 32_000, 33_000)
    merit: tuple[int, ...] = (120, 130, 140, 150)
    scaling: int = -3
    missing_beam: int | None = None
    bottom_after: timedelta = timedelta(milliseconds=120)


def vectors() -> np.ndarray:
    """Return the beams' unit vectors, away from the instrument."""
    s, c = np.sin(np.deg2rad(ANGLE)), np.cos(np.deg2rad(ANGLE))
    return np.array([[s, 0, c], [0, -s, c], [-s, 0, c], [0, s, c]])


def in_system(velocity: tuple[float, float, float], system: str) -> np.ndarray:
    """Return a velocity as the instrument stores it: along beams, or x, y and z twice, as east, north and up."""
    return vectors() @ velocity if system == "beam" else np.array([*velocity, velocity[2]])


def text() -> bytes:
    """Return the record with the configuration."""
    s, c = 1 / (2 * np.sin(np.deg2rad(ANGLE))), 1 / (2 * np.cos(np.deg2rad(ANGLE)))
    rows = [[s, 0, -s, 0], [0, -s, 0, s], [c, 0, c, 0], [0, c, 0, c]]
    matrix = ",".join(f"M{i + 1}{j + 1}={rows[i][j]:.6f}" for i, j in np.ndindex(4, 4))
    beams = (
        f"BEAMCFGLIST,BEAM={k},THETA={ANGLE:.2f},PHI=0.00,FREQ=500,BW=25,BRD=1,HWBEAM={k},ZNOM=100.00"
        for k in (1, 2, 3, 4)
    )
    lines = (
        'ID,STR="Signature500",SN=100259',
        f'GETBURST,NC={N_CELLS},NB=4,CS={CELL:.3f},BD={BLANK:.3f},CY="BEAM",PL=0.0,SR=1,NS=1,VR=4.50,VP=0.000,DF=3,NPING=1',
        "GETPLAN,MIAVG=600,AVG=0,BURST=1,MIBURST=1800,SA=35.0",
        f"GETXFBURST,ROWS=4,COLS=4,{matrix}",
        *beams,
        "GETUSER,POFF=9.50,DECL=3.50,HX=0,HY=0,HZ=0",
    )
    return nortek_record(TEXT, b"\x10" + "\r\n".join(lines).encode() + b"\r\n\x00")


def _head(survey: Survey, when: datetime, config: int, beams_cy: int, offset: int) -> bytes:
    year, month, *rest = when.timetuple()[:6]
    clock = struct.pack("<6BH", year - 1900, month - 1, *rest, when.microsecond // 100)
    angles = (round(100 * each) for each in (survey.heading, survey.pitch, survey.roll))
    sensors = struct.pack("<HhIHhhH", 15000, 1200, 45_000, *angles, beams_cy)
    return struct.pack("<BBHI", 3, offset, config, 100259) + clock + sensors


def _status(survey: Survey) -> int:
    return (5 if survey.down else 4) << 25 | 1 << 28


def burst(survey: Survey, k: int) -> bytes:
    """Return the record of one ping; a ping a second."""
    beams_cy = 4 << 12 | SYSTEMS.index(survey.system) << 10 | N_CELLS
    head = _head(survey, START + timedelta(seconds=k), 0b11101111, beams_cy, 76)
    rest = struct.pack("<HHBbH6hhHHbb", 1000, 50, 60, 0, 150, *[0] * 6, 3000, 0, 0, -3, 0)
    tail = struct.pack("<hhHHII", 0, 0, 0, 0, _status(survey), k + 1)
    stored = in_system(survey.water, survey.system)
    velocity = np.repeat(np.round(1000 * stored), N_CELLS).astype("<i2").tobytes()
    levels = bytes([120] * 4 * N_CELLS + [95] * 4 * N_CELLS)
    return nortek_record(BURST, head + rest + tail + velocity + levels)


def bottom(survey: Survey, k: int, offset: int = 78) -> bytes:
    """Return a bottom-track record, shortly after a ping; its data begin at an offset that it states."""
    beams_cy = 4 << 12 | SYSTEMS.index(survey.bottom_system) << 10
    when = START + timedelta(seconds=k) + survey.bottom_after
    head = _head(survey, when, 0b1100101111, beams_cy, offset)
    rest = struct.pack("<HHBBH6hIHHbb", 0, 50, 0, 0, 150, *[0] * 6, 5000, 0, 0, survey.scaling, 0)
    tail = struct.pack("<hhIII", 0, 0, 0, _status(survey), k + 1) + bytes(offset - 78)
    along = in_system(survey.bottom, survey.bottom_system)
    seen = np.round(10.0**-survey.scaling * along).astype(int).tolist()
    if survey.missing_beam is not None:
        seen[survey.missing_beam] = -32768
    data = struct.pack("<4i4i4H", *seen, *survey.distance_mm, *survey.merit)
    return nortek_record(BOTTOM, head + rest + tail + data)


def ad2cp(survey: Survey, n: int = 5) -> bytes:
    """Return a file of ``n`` pings, each with a bottom track."""
    return text() + b"".join(burst(survey, k) + bottom(survey, k) for k in range(n))
