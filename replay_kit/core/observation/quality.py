"""What is said of a measured value: whether it is used, and why not."""

from enum import IntEnum, IntFlag

import numpy as np
from numpy.typing import NDArray


class Flag(IntEnum):
    """QARTOD flags."""

    GOOD = 1
    NOT_EVALUATED = 2
    SUSPECT = 3
    FAIL = 4
    MISSING = 9


_GOOD, _SUSPECT = np.int8(Flag.GOOD), np.int8(Flag.SUSPECT)


def usable(flags: NDArray[np.int8]) -> NDArray[np.bool_]:
    """Return which bins are used: good ones and suspect ones; where the latter are unwanted, measurement quality control fails them."""
    return np.asarray((flags == _GOOD) | (flags == _SUSPECT))


class Reason(IntFlag):
    """Why a bin or a ping was not used, or why it is suspect: its flag says which."""

    NONE = 0
    MISSING = 1
    ABOVE_SURFACE = 2
    BELOW_GRID = 4
    OUTSIDE_REGION = 8
    PLATFORM_REFERENCE = 16
    NOT_EARTH_COORDINATES = 32
    NO_POSITION = 64
    MALFORMED = 128
    GROSS_RANGE = 256
    ON_LAND = 512
    BELOW_BOTTOM = 1024
    LOW_CORRELATION = 2048
    LOW_AMPLITUDE = 4096
    LOW_SNR = 8192
    LOW_PERCENT_GOOD = 16384
    ERROR_VELOCITY = 32768
    HIGH_SPEED = 65536
    TILT = 131072
    SIDELOBE = 262144
    OUTLIER = 524288
    AT_SURFACE = 1048576
    DUPLICATE = 2097152
    OUT_OF_ORDER = 4194304
    DEAD = 8388608
    INCONSISTENT = 16777216


def reasons_of(reasons: NDArray[np.int32], flags: NDArray[np.int8]) -> list[tuple[str, int]]:
    """Return the names of the reasons for which bins are not used, each with its number of bins."""
    not_used = reasons[~usable(flags)]
    found = int(np.bitwise_or.reduce(not_used, initial=0))
    return [
        (str(reason.name).lower(), int(np.count_nonzero(not_used & reason.value)))
        for reason in Reason
        if found & reason.value
    ]
