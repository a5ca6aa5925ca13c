"""Whether the texts of a NetCDF-4 file can be read: the HDF5 library never returns from a global heap whose free space has no size.

Source: HDF5 File Format Specification, III.E "Disk Format: Level 1E - Global Heap".
"""

import mmap
import struct
from pathlib import Path

#: Signature, version and three zeros, which damage elsewhere leaves.
_BEGINS = b"GCOL\x01\x00\x00\x00"
_SIZE = struct.Struct("<8xQ")
#: Number, count of references, reserved bytes and size of an object, whose bytes follow.
_OBJECT = struct.Struct("<HH4xQ")


def endless_heap(path: Path) -> int | None:
    """Return where a global heap begins that the HDF5 library would read for ever [bytes]; None without one.

    Args:
        path: A file that is not empty.
    """
    with open(path, "rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        at = data.find(_BEGINS)
        while at >= 0:
            if _is_endless(data, at):
                return at
            at = data.find(_BEGINS, at + 1)
    return None


def _is_endless(data: mmap.mmap, begin: int) -> bool:
    """Return whether the objects of a heap lead to free space without a size, from which no step leads on."""
    if begin + _SIZE.size > len(data):
        return False
    end = min(begin + _SIZE.unpack_from(data, begin)[0], len(data))
    at = begin + _SIZE.size
    while at + _OBJECT.size <= end:
        number, _, size = _OBJECT.unpack_from(data, at)
        if number == 0 and size == 0:
            return True
        # the size of free space includes its head, and objects begin at multiples of eight bytes
        at += size if number == 0 else _OBJECT.size + (size + 7) // 8 * 8
    return False
