"""``python -m tests.fuzz``: every sample and conformance log damaged in many ways.

``python -m tests.fuzz atheris NAME``: guided; ``python -m tests.fuzz hostile [WORDS]``: inputs made to take time or memory.
"""

import argparse
import resource
import sys
import time

#: More memory than this means that something was allocated on a damaged file's word.
_MOST_MB = 300.0


def main(arguments: list[str] | None = None) -> int:
    """Run, print what is wrong, return the number of logs with something wrong."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("kind", nargs="?", choices=["damage", "atheris", "hostile"], default="damage")
    parser.add_argument("name", nargs="?", help="the parser, for atheris; words in the names of hostile inputs")
    parser.add_argument("--places", type=int, default=64, help="cuts, and flips, of each log")
    parser.add_argument("--seconds", type=int, default=600, help="how long atheris runs")
    options = parser.parse_args(arguments)
    if options.kind == "atheris":
        # imported here, as it must be what first imports the parsers
        from tests.fuzz.guided import run

        return run(options.name, options.seconds)
    if options.kind == "hostile":
        from tests.fuzz.hostile import run_all

        return run_all(options.name or "")
    from tests.fuzz import damage, damage_vehicle

    begin, bad, count = time.perf_counter(), 0, 0
    for kind in (damage, damage_vehicle):
        for file in kind.logs():
            wrong = kind.damage(file, options.places)
            bad, count = bad + bool(wrong), count + 1
            print("".join(f"{file}: {words}\n" for words in wrong), end="")
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    print(f"{count} logs, {options.places} cuts and flips each, {time.perf_counter() - begin:.0f} s, peak {peak:.0f} MB: {bad} bad")
    return bad + (peak > _MOST_MB)


if __name__ == "__main__":
    sys.exit(main())
