"""``python -m tests.fuzz``: every sample and conformance log damaged in many ways; ``python -m tests.fuzz atheris NAME``: guided."""

import argparse
import resource
import sys
import time
import zlib
from pathlib import Path

import numpy as np

from tests.fuzz.damage import check_cuts, check_flips, places

ROOT = Path(__file__).resolve().parents[2]
#: More memory than this means that something was allocated on a damaged file's word.
MOST_MB = 300.0


def logs() -> list[Path]:
    """Return the MCAP logs of this machine: the samples, and the shared ones where they are."""
    return sorted([*(ROOT / "sample_logs").glob("*.mcap"), *(ROOT.parent / "shared" / "data" / "logs").rglob("*.mcap")])


def damage(file: Path, count: int) -> list[str]:
    """Return what is wrong with reading a log that is cut, and has a bit flipped, at that many places each."""
    data = file.read_bytes()
    rng = np.random.default_rng(zlib.crc32(file.name.encode()))
    flips = [(place, int(rng.integers(8))) for place in places(len(data), count, seed=2)]
    return check_cuts(data, places(len(data), count, seed=1)) + check_flips(data, flips)


def main(arguments: list[str] | None = None) -> int:
    """Run, print what is wrong, return the number of logs with something wrong."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("kind", nargs="?", choices=["damage", "atheris"], default="damage")
    parser.add_argument("name", nargs="?", help="the parser, for atheris")
    parser.add_argument("--places", type=int, default=64, help="cuts, and flips, of each log")
    parser.add_argument("--seconds", type=int, default=600, help="how long atheris runs")
    options = parser.parse_args(arguments)
    if options.kind == "atheris":
        from tests.fuzz.guided import run

        return run(options.name, options.seconds)
    begin, bad = time.perf_counter(), 0
    for file in logs():
        wrong = damage(file, options.places)
        bad += bool(wrong)
        print("".join(f"{file}: {words}\n" for words in wrong), end="")
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    print(f"{len(logs())} logs, {options.places} cuts and flips each, {time.perf_counter() - begin:.0f} s, peak {peak:.0f} MB: {bad} bad")
    return bad + (peak > MOST_MB)


if __name__ == "__main__":
    sys.exit(main())
