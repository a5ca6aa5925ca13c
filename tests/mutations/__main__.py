"""Mutation testing: ``python -m tests.mutations --seed 1 --count 60`` changes single points of the code and names what no test notices."""

import argparse
import json
import os
import queue
import tempfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

from tests.mutations.covering import Recording, covering, seconds, within_budget
from tests.mutations.draw import Mutant, drawn, mutants
from tests.mutations.run import SLACK, SLOWER, Verdict, copied, judged, warm
from tests.mutations.store import THREADS, recordings
from tests.mutations.targets import targets
from tests.places import ROOT


def main() -> int:
    """Draw, judge and print; return 0."""
    options = _options()
    os.environ.update(THREADS)  # before anything imports numpy
    chosen = drawn(mutants(ROOT, targets(ROOT)), ROOT, options.seed, options.count)
    with tempfile.TemporaryDirectory() as folder:
        copies = [copied(ROOT, Path(folder, str(worker))) for worker in range(options.workers)]
        judgements = _judge(chosen, copies, recordings(ROOT, copies[0]), options.budget)
    rows = [_row(mutant, verdict) for mutant, verdict in zip(chosen, judgements, strict=True)]
    killed = sum(verdict.killed for verdict in judgements)
    share = 100 * killed / len(rows)
    for row in rows:
        if not row["killed"]:
            print("{file}:{line}: {kind}: {how}\n  - {before}\n  + {after}".format(**row))
    print(
        f"seed {options.seed}: {len(rows)} mutants, {killed} killed, {len(rows) - killed} survived, {share:.0f} % killed"
    )
    if options.json:
        options.json.write_text(
            json.dumps({"seed": options.seed, "mutants": rows}, indent=1) + "\n", encoding="utf-8"
        )
    return 0


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m tests.mutations", description=__doc__)
    parser.add_argument(
        "--seed",
        type=int,
        required=True,
        help="draws the mutants: the same seed and code give the same ones",
    )
    parser.add_argument("--count", type=int, default=60, help="number of mutants [60]")
    parser.add_argument(
        "--budget",
        type=float,
        default=60.0,
        help="seconds of tests for one mutant, by their recorded length [60]",
    )
    parser.add_argument(
        "--workers", type=int, default=1, help="mutants judged at the same time [1]"
    )
    parser.add_argument(
        "--json", type=Path, help="also write every mutant and its verdict to this file"
    )
    options = parser.parse_args()
    if min(options.count, options.workers) < 1 or options.budget <= 0:
        parser.error("--count, --workers and --budget must be positive")
    return options


def _judge(
    chosen: list[Mutant], copies: list[Path], recorded: list[Recording], budget: float
) -> list[Verdict]:
    """Return the verdicts in the order of the mutants; every worker has a copy of the project to itself."""
    lasting, server = seconds(recorded), warm(ROOT)
    free: queue.SimpleQueue[Path] = queue.SimpleQueue()
    for copy in copies:
        free.put(copy)

    def judge(mutant: Mutant, tests: list[str]) -> Verdict:
        if not tests:
            print("S", end="", flush=True)
            return Verdict(False, "no test executes it", 0.0)
        taken = within_budget(tests, lasting, budget)
        copy = free.get()
        try:
            verdict = judged(
                mutant, copy, taken, SLACK + SLOWER * sum(lasting[test] for test in taken), server
            )
        finally:
            free.put(copy)
        print("." if verdict.killed else "S", end="", flush=True)
        if not verdict.killed and len(taken) < len(tests):
            return replace(
                verdict, how=f"budget: {verdict.how}, {len(tests) - len(taken)} slower ones not run"
            )
        return verdict

    executing = [covering(mutant, recorded) for mutant in chosen]
    with ThreadPoolExecutor(len(copies)) as pool:
        verdicts = list(pool.map(judge, chosen, executing))
    print()
    return verdicts


def _row(mutant: Mutant, verdict: Verdict) -> dict[str, object]:
    site = mutant.site
    before, after = mutant.lines((ROOT / mutant.path).read_text(encoding="utf-8"))
    return {
        **{
            "file": mutant.path.as_posix(),
            "line": site.line,
            "kind": site.kind,
            "before": before,
            "after": after,
        },
        **{"killed": verdict.killed, "how": verdict.how, "seconds": round(verdict.seconds, 2)},
    }


if __name__ == "__main__":
    raise SystemExit(main())
