"""``python -m tests.fuzz``: every sample and conformance log damaged in many ways; with ``--count`` small files of every format.

``... atheris NAME``: guided; ``... kill [KIND]``: signals; ``... hostile [WORDS]``: inputs made to take time or memory;
``... own [KINDS]``: the files of this program.
"""

import argparse
import resource
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

#: More memory than this means that something was allocated on a damaged file's word.
_MOST_MB = 300.0


def main(arguments: list[str] | None = None) -> int:
    """Run, print what is wrong, return the number of logs with something wrong."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument(
        "kind", nargs="?", choices=["damage", "atheris", "kill", "hostile", "own"], default="damage"
    )
    parser.add_argument(
        "name", nargs="?", help="the parser, for atheris; words in the names of hostile inputs"
    )
    parser.add_argument("--places", type=int, default=128, help="damages of each log")
    parser.add_argument("--seconds", type=int, default=600, help="how long atheris runs")
    parser.add_argument(
        "--count",
        type=int,
        default=0,
        help="random damages instead of places; signals of each kind to each command (50)",
    )
    parser.add_argument(
        "--seed", type=int, default=1, help="of random damages, and of the instants of kills"
    )
    options = parser.parse_args(arguments)
    if options.kind == "atheris":
        # imported here, as it must be what first imports the parsers
        from tests.fuzz.guided import run

        return run(options.name, options.seconds)
    if options.kind == "kill":
        return _kill(options.count or 50, options.seed, options.name)
    if options.kind == "hostile":
        from tests.fuzz.hostile import run_all

        return run_all(options.name or "")
    if options.kind == "own":
        from tests.fuzz.own import run_all as run_own

        return run_own(options.count or 2000, options.seed, tuple((options.name or "").split()))
    return _sweep(options.count, options.seed, options.places)


def _kill(count: int, seed: int, name: str | None) -> int:
    from tests.fuzz.kill import KINDS, SIGNALS, kill, make_inputs

    wrong = 0
    with tempfile.TemporaryDirectory() as folder:
        make_inputs(Path(folder), 10)
        for kind in [name] if name else KINDS:
            for sent in SIGNALS:
                result = kill(kind, Path(folder), count, seed, sent)
                said = f"{result.kills} times, {result.resumed} with a checkpoint left, {result.finished} ended before"
                words = "".join(f"{words}\n" for words in result.wrong)
                print(
                    f"{words}{kind}: {sent.name} {said}: {len(result.wrong)} bad",
                    flush=True,
                )
                wrong += len(result.wrong)
    return wrong


def _sweep(count: int, seed: int, of_each: int) -> int:
    """Damage small logs of all formats, or without a count each log of this machine; return the number of damages with something wrong."""
    from tests.fuzz import damage
    from tests.fuzz.subjects import damaged, of_file, sweep

    begin, done, bad = time.perf_counter(), Counter[str](), Counter[str]()
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        files = (
            (str(file), damaged(subject, number, seed, place))
            for file in damage.logs()
            for subject in (of_file(file),)
            for number in range(of_each)
        )
        for name, wrong in sweep(count, seed, place) if count else files:
            done[name] += 1
            bad[name] += bool(wrong)
            print("".join(f"{words}\n" for words in wrong), end="", flush=True)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    print(", ".join(f"{name} {bad[name]} of {number}" for name, number in done.items() if count))
    print(
        f"{done.total()} damages, seed {seed}, {time.perf_counter() - begin:.0f} s, peak {peak:.0f} MB: {bad.total()} bad"
    )
    return bad.total() + (peak > _MOST_MB)


if __name__ == "__main__":
    sys.exit(main())
