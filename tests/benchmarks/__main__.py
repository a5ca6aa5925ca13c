"""``python -m tests.benchmarks [NAME ...] --json FILE``: measure, print a table, write it as JSON."""

import argparse
import json
from collections.abc import Callable
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

from tests.benchmarks.measure import environment, limits

_NAMES = "atsea dives estimator faults forecasts front logs long pages pings planners safety size start windows"
BENCHMARKS: dict[str, Callable[[bool], list[dict[str, Any]]]] = {
    name: import_module(f"tests.benchmarks.{name}").rows for name in _NAMES.split()
}


def main(arguments: list[str] | None = None) -> dict[str, Any]:
    """Run the named benchmarks, all without a name, and return what was measured."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks", description=__doc__)
    parser.add_argument(
        "names",
        nargs="*",
        choices=[*BENCHMARKS, []],
        metavar="NAME",
        help=f"{', '.join(BENCHMARKS)}; default all",
    )
    parser.add_argument("--json", type=Path, help="file of the results")
    parser.add_argument(
        "--tiny", action="store_true", help="once, at a tiny size: do they still work?"
    )
    parser.add_argument("--threads", type=int, default=1, help="BLAS threads")
    parser.add_argument("--count", type=int, default=300, help="missions of safety")
    options = parser.parse_args(arguments)
    names = options.names or list(BENCHMARKS)
    benchmarks = BENCHMARKS | {"safety": partial(BENCHMARKS["safety"], count=options.count)}
    with threadpool_limits(options.threads):
        result = {
            "limits": limits(options.tiny),
            "threads": options.threads,
            "rows": [],
        } | environment()
        for name in names:
            result["rows"] += benchmarks[name](options.tiny)
    _print(result)
    if options.json is not None:
        options.json.write_text(json.dumps(result, indent=1))
    return result


def _print(result: dict[str, Any]) -> None:
    print(f"{result['machine']['processor']}, {result['threads']} BLAS thread(s), ", end="")
    print(", ".join(f"{name} {value:.1f}" for name, value in result["limits"].items()))
    for row in result["rows"]:
        more = {name: value for name, value in row.items() if value is not None}
        name, ours_s, peer, error = (more.pop(of) for of in ("name", "ours_s", "peer", "error"))
        peer_s, ratio, asked = (more.pop(of, None) for of in ("peer_s", "ratio", "asked"))
        than = "" if ratio is None else f", peer {peer_s:.3f} s: {ratio:8.1f}x, asked {asked:g}x"
        print(f"\n{name}\n  {ours_s:.3f} s{than}; peer: {peer}")
        print("  " + ", ".join(f"{of} {value:.1e}" for of, value in error.items()))
        print("  " + ", ".join(f"{of} {_short(value)}" for of, value in more.items()))


def _short(value: Any) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)


if __name__ == "__main__":
    main()
