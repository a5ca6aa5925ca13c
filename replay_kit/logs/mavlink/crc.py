"""The checksum of MAVLink frames.

CRC-16/MCRF4XX, which MAVLink calls X.25: polynomial 0x1021 with its bits reversed, initial value 0xFFFF, over the frame after its marker
and one more byte, which is derived from the message's definition (https://mavlink.io/en/guide/serialization.html#checksum). It is
``binascii.crc_hqx`` of the bytes with their bits reversed, its own bits reversed.
"""

from binascii import crc_hqx

import numpy as np
from numpy.typing import NDArray

from replay_kit.logs.shared.record_chain import Indices

_MIRROR = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))
_MIRRORED = np.frombuffer(_MIRROR, dtype=np.uint8).astype(np.uint16)
_AFTER_BYTE = np.array([crc_hqx(bytes((byte,)), 0) for byte in range(256)], dtype=np.uint16)
_INITIAL = 0xFFFF


def checksums(data: bytes, start: Indices, end: Indices, extra: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """Return the checksum of parts of the data, each followed by one more byte, shape (n,).

    Args:
        data: The bytes.
        start: Where each part begins, shape (n,).
        end: Where it ends.
        extra: The byte that follows each.
    """
    mirrored = data.translate(_MIRROR)
    parts = zip(start.tolist(), end.tolist(), strict=True)
    crc = np.array([crc_hqx(mirrored[first:stop], _INITIAL) for first, stop in parts], dtype=np.uint16)
    crc = crc << np.uint16(8) ^ _AFTER_BYTE[crc >> np.uint16(8) ^ _MIRRORED[extra & 0xFF]]
    found: NDArray[np.uint16] = _MIRRORED[crc & 0xFF] << np.uint16(8) | _MIRRORED[crc >> np.uint16(8)]
    return found
