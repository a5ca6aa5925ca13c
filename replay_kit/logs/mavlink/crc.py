"""The checksum of MAVLink frames, many at a time.

CRC-16/MCRF4XX, which MAVLink calls X.25: polynomial 0x1021 with its bits reversed, initial value 0xFFFF, over the frame after its marker
and one more byte, which is derived from the message's definition (https://mavlink.io/en/guide/serialization.html#checksum).
"""

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from replay_kit.logs.shared.record_chain import Indices

_REVERSED = 0x8408
#: Frames are processed together when their lengths differ by fewer words.
_WORDS = 16
PADDING = 2 * _WORDS


def checksums(
    data: NDArray[np.uint8], start: Indices, end: Indices, extra: NDArray[np.uint16]
) -> NDArray[np.uint16]:
    """Return the checksum of parts of the data, each followed by one more byte, shape (n,).

    Args:
        data: The bytes, and ``PADDING`` more of any value after the last part.
        start: Where each part begins, shape (n,).
        end: Where it ends.
        extra: The byte that follows each.
    """
    words = (end - start) // 2
    longest_first = np.argsort(words.astype(np.uint16), kind="stable")[::-1]
    words, first = words[longest_first], start[longest_first]
    register = np.full(start.size, 0xFFFF, dtype=np.uint16)
    edges = np.flatnonzero(np.diff(-(-words // _WORDS), prepend=-1, append=-1))
    for low, high in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        most = int(words[low])
        if most == 0:
            continue
        # one row a word, one column a part; parts without such a word come last
        rows = np.ascontiguousarray(
            sliding_window_view(data, 2 * most)[first[low:high]].view("<u2").T
        )
        having = high - np.searchsorted(words[low:high][::-1], np.arange(most), side="right")
        for row, stop in zip(rows, having.tolist(), strict=True):
            register[low:stop] = _TWO_BYTES.take(register[low:stop] ^ row[: stop - low])
    crc = np.empty_like(register)
    crc[longest_first] = register
    odd = np.flatnonzero((end - start) % 2)
    crc[odd] = _with_byte(crc[odd], data[end[odd] - 1])
    return _with_byte(crc, extra)


def _with_byte(
    register: NDArray[np.uint16], byte: NDArray[np.uint8] | NDArray[np.uint16]
) -> NDArray[np.uint16]:
    return (register >> np.uint16(8)) ^ _ONE_BYTE.take((register ^ byte) & 0xFF)


def _after_bits(bits: int) -> NDArray[np.uint16]:
    """Return the value of each register, shape (2**bits,), after that many bits are shifted out."""
    register = np.arange(1 << bits, dtype=np.uint16)
    for _ in range(bits):
        register = (register >> np.uint16(1)) ^ (register & np.uint16(1)) * np.uint16(_REVERSED)
    return register


# The register is as wide as a word: its value after sixteen bits depends on its sum with the word alone.
_ONE_BYTE = _after_bits(8)
_TWO_BYTES = _after_bits(16)
