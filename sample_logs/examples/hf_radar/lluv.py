"""Radials from LLUV text, the form of CODAR's files (``*.ruv``).

With a glider's log they are one stream of measurements::

    for measurement in heapq.merge(observations(log), read_radials(path), key=lambda each: each.time_ns):
        state, innovation = estimator.step(state, measurement)
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from hf_radar.radial import radial

from replay_kit.core.errors import LogError
from replay_kit.core.observation import LinearMeasurement, Source

_COLUMNS = ("LOND", "LATD", "VELO", "HEAD", "ETMP", "VFLG")
# m/s; light travels so far in a microsecond as a wave of 1 MHz is long
_LIGHT = 299.792458
# cm/s; what the files write where no error is known
_NO_ERROR = 999.0
# cm/s; the resolution of a Doppler spectrum leaves about so much
_LEAST_ERROR = 3.0


def read_radials(path: Path) -> Iterator[LinearMeasurement]:
    """Yield the radials of a file, flagged where the radar rejects one or states no error of it.

    Raises:
        LogError: The file lacks its time, its frequency or a column.
    """
    lines = path.read_text(encoding="latin-1").splitlines()
    # tables of diagnostics follow, and repeat some keys: the first counts
    stated = [line for line in reversed(lines) if line.startswith("%") and ":" in line]
    head = dict(line[1:].split(":", 1) for line in stated)
    names = head.get("TableColumnTypes", "").split()
    missing = [
        name
        for name in ("TimeStamp", "TransmitCenterFreqMHz", *_COLUMNS)
        if name not in head and name not in names
    ]
    if missing:
        raise LogError(
            f"{path}: expected radials as LLUV text, it lacks {', '.join(missing)}; give a file of one station"
        )
    year, month, day, hour, minute, second = map(int, head["TimeStamp"].split())
    time = np.datetime64(f"{year:04}-{month:02}-{day:02}T{hour:02}:{minute:02}:{second:02}", "ns")
    # Stewart and Joy (1974, Deep-Sea Res. 21): a radar's wavelength over 8 pi
    depth = _LIGHT / float(head["TransmitCenterFreqMHz"]) / (8.0 * np.pi)
    rows = [line for line in lines if line.strip() and not line.startswith("%")]
    for number, row in enumerate(rows):
        values = dict(zip(names, map(float, row.split()), strict=True))
        east, north, speed, heading, error, flag = (values[name] for name in _COLUMNS)
        known = error < _NO_ERROR
        yield radial(
            Source(0, path.name, number, int(time.astype(np.int64))),
            (east, north),
            heading,
            1e-2 * speed,
            1e-2 * max(error, _LEAST_ERROR),
            depth,
            good=flag == 0.0 and known,
        )
