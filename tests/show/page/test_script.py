"""The script that draws the figures is plotly's own, unchanged, and its licence goes with it."""

import gzip
import hashlib
from importlib.resources import files

SHA256 = "79542150855a52c567260e3137095dbe2b744e6d702a5cabe67da246942fba7a"


def test_the_script_is_the_published_one():
    packed = files("replay_kit.show.page").joinpath("plotly-cartesian.min.js.gz").read_bytes()
    script = gzip.decompress(packed)
    assert hashlib.sha256(script).hexdigest() == SHA256
    assert script[:60].decode().split("\n")[1] == "* plotly.js (cartesian - minified) v4.1.1"
    assert b"Licensed under the MIT license" in script[:200]
    # the time of packing is not in the file
    assert packed[4:8] == b"\0\0\0\0"
