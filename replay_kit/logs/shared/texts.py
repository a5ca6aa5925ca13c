"""Logs that are text, told by their first bytes before the libraries that read them are loaded."""

import zlib

GZIP_MAGIC = b"\x1f\x8b"
#: Names that the first column of a SeaExplorer's file has.
FIRST_COLUMNS = ("timestamp", "pld_realtimeclock")


def is_seaexplorer(head: bytes) -> bool:
    """Return whether a file that begins with these bytes is a SeaExplorer's, compressed or not."""
    if head.startswith(GZIP_MAGIC):
        try:
            head = zlib.decompressobj(wbits=31).decompress(head, 256)
        except zlib.error:
            return False
    return head.lstrip(b"\xef\xbb\xbf").split(b";", 1)[0].strip().lower() in {
        name.encode() for name in FIRST_COLUMNS
    }


def is_csv(head: bytes) -> bool:
    """Return whether a file that begins so is a table in text: names with commas, semicolons or tabs between them."""
    lines = head.split(b"\n")
    first = next((line for line in lines[:-1] if not line.startswith(b"#")), b"")
    try:
        text = first.decode("utf-8-sig").strip().replace("\t", ",")
    except UnicodeDecodeError:
        return False
    return text.isprintable() and max(map(text.count, ",;")) >= 3
