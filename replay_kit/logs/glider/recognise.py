"""Recognises a SeaExplorer's text file, before the libraries that read gliders' files are loaded."""

import zlib

GZIP_MAGIC = b"\x1f\x8b"
#: Names that the first column of such a file has.
FIRST_COLUMNS = ("timestamp", "pld_realtimeclock")


def is_seaexplorer(head: bytes) -> bool:
    """Return whether a file that begins with these bytes is one, compressed or not."""
    if head.startswith(GZIP_MAGIC):
        try:
            head = zlib.decompressobj(wbits=31).decompress(head, 256)
        except zlib.error:
            return False
    return head.lstrip(b"\xef\xbb\xbf").split(b";", 1)[0].strip().lower() in {
        name.encode() for name in FIRST_COLUMNS
    }
