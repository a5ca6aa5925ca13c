"""A store of 20 GB: no more bytes than the chunks of the box, no more memory than a few of them."""

import math
import subprocess
import sys
from itertools import product

import pytest
import xarray as xr

from tests.forecast.remote.servers import Files, serving
from tests.forecast.remote.virtual import CHUNKS, VirtualStore
from tests.places import ROOT, SAMPLES

#: 60 x 60 points; the log asks for 8 times.
BOX = (151.02, -41.03, 154.03, -38.02)
# Peak of resident memory of a process that imports and runs one command [MB]. Not by getrusage, in which a new process begins with the
# peak of the one that started it.
_MEASURED = """
import sys
from tests.benchmarks.measure import peak_mb
from tests.command import invoke
done = invoke(sys.argv[1:])
print(done.output)
print("PEAK", peak_mb())
sys.exit(done.exit_code)
"""


def touched(shape, first):
    """Chunks of both components that a box touches, in bytes."""
    ends = [
        range(low // c, (low + n - 1) // c + 1)
        for low, n, c in zip(first, shape, CHUNKS, strict=True)
    ]
    return 2 * len(list(product(*ends))) * 2 * math.prod(CHUNKS)


def test_no_chunk_is_received_that_the_box_does_not_touch(asker):
    store = VirtualStore()
    assert store.size > 20e9
    small = {"start": "2018-11-15T06:00Z", "end": "2018-11-15T18:00Z"}
    with serving(Files(store)) as files:
        found = asker(files.url, BOX, logs=small, levels=(5.0, 100.0))
    shape = tuple(found.sizes[dim] for dim in ("member", "time", "depth", "lat", "lon"))
    assert shape == (4, 2, 8, 60, 60)
    chunks = touched(shape, (0, 1, 0, 380, 1221))
    assert sum(store.made.values()) == chunks
    assert files.sent < 1.1 * chunks


@pytest.mark.full
def test_a_box_of_a_store_of_20_gb(tmp_path):
    store, cache = VirtualStore(), f"--forecast.cache={tmp_path / 'cache'}"
    levels = ",".join(str(5 + 15 * k) for k in range(1, 29))
    with serving(Files(store)) as files:
        out = [tmp_path / "first.mcap", tmp_path / "second.mcap"]
        asked = f"--ensemble {files.url} --region {','.join(map(str, BOX))} --levels {levels}"
        for result, more in zip(out, ("", "--offline"), strict=True):
            words = f"replay {SAMPLES}/survey.mcap {asked} --modes 20 {cache} -o {result} {more}"
            count = len(files.asked)
            done = subprocess.run(
                [sys.executable, "-c", _MEASURED, *words.split()],
                cwd=ROOT,
                capture_output=True,
                text=True,
                check=False,
            )
            print(done.stdout[-300:], done.stderr[-2000:])
            assert done.returncode in (0, 6), done.stdout + done.stderr
            assert float(done.stdout.rpartition("PEAK ")[2]) < 600.0
        assert len(files.asked) == count
    (held,) = (tmp_path / "cache").glob("*.nc")
    with xr.open_dataset(held) as ds:
        shape = tuple(ds.sizes[dim] for dim in ("member", "time", "depth", "lat", "lon"))
    assert shape == (4, 8, 30, 60, 60)
    chunks = touched(shape, (0, 2, 0, 380, 1221))
    print(f"sent {files.sent}, chunks {chunks}, ratio {files.sent / chunks:.4f}")
    assert sum(store.made.values()) <= 1.1 * chunks
    assert files.sent <= 1.1 * chunks
    assert out[0].read_bytes() == out[1].read_bytes()
