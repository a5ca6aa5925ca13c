"""``python -m tests.record compare [NAME ...]``: today's answers beside those of 0.3, and how they differ.

``python -m tests.record make FOLDER [NAME ...]`` writes today's into a folder, as 0.3 once did into ``answers/``.
"""

import argparse
import json
import lzma
from collections.abc import Callable, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from tests.benchmarks import faults, pings
from tests.command import succeed
from tests.places import DATA, SAMPLES
from tests.record import measured, missions, opened
from tests.record.record import difference, load, rounded

# The study of the paper: of the samples with few modes, and at full rank.
_STUDIES = {
    "sample": (SAMPLES, "--levels 5,150,500 --modes 60 --pairs 5"),
    "natl_nemo": (DATA / "natl_nemo", "--pairs 5"),
}
_FAULTS = ("runs", *faults.ENDS, "unknowable", "median_pings")


def paper(name: str) -> dict[str, Any]:
    """Return Tables I and II, the errors after some pings, and the closest approaches of Table III [m], of one study.

    They are what the charts of its page show.
    """
    source, options = _STUDIES[name]
    with TemporaryDirectory() as folder:
        files = ["--ensemble", str(source / "ensemble.nc"), "--truth", str(source / "truth.nc")]
        succeed(["experiment", "paper", *files, *options.split(), "-o", folder, "--overwrite"])
        told = json.loads((Path(folder) / "paper.json").read_text())
    figures = ("elements", "rel_error", "rmse", "bound")
    found: dict[str, Any] = {
        table: {_method(row): [row[figure] for figure in figures] for row in told[table]}
        for table in ("table1", "table2")
    }
    found["sparse"] = {f"{row['pings']} {_method(row)}": row["rel_error"] for row in told["sparse"]}
    found["glides"] = {row["flow"]: row["closest_approach"] for row in told["table3"]}
    return found


def _method(row: Mapping[str, Any]) -> str:
    return " ".join(str(row[name]) for name in ("method", "rung", "modes") if row.get(name))


def _of_faults() -> dict[str, Any]:
    found = {row["name"]: row for row in faults.rows(tiny=False)}
    sound = found.pop("sound logs")
    counts = [sound[name] for name in ("runs", "sound", "unfit", "mute", "false_alarms")]
    rows = {name: [row[figure] for figure in _FAULTS] for name, row in found.items()}
    return rows | {"sound logs": counts}


#: What makes today's answers, by the name of the record.
MAKERS: dict[str, Callable[[], dict[str, Any]]] = {
    "files": opened.answers,
    "measured": lambda: measured.answers(measured.logs()),
    "accuracy": lambda: {
        name: pings.scores(sea) for name, sea in pings.SEAS.items() if sea.ensemble.exists()
    },
    "paper": lambda: {name: paper(name) for name in _STUDIES if _STUDIES[name][0].exists()},
    "faults": _of_faults,
    "missions": lambda: {name: missions.answers(name) for name in missions.sets()},
}


def main(arguments: list[str] | None = None) -> None:
    """Compare or make the named records, all without a name."""
    parser = argparse.ArgumentParser(prog="python -m tests.record", description=__doc__)
    parser.add_argument("what", choices=["compare", "make"])
    parser.add_argument("names", nargs="*", metavar="[FOLDER] NAME", help=", ".join(MAKERS))
    options = parser.parse_args(arguments)
    folder = Path(options.names.pop(0)) if options.what == "make" else None
    with threadpool_limits(1):
        for name in options.names or MAKERS:
            today = rounded(MAKERS[name]())
            if folder is not None:
                (folder / f"{name}.json.xz").write_bytes(
                    lzma.compress(json.dumps(today).encode(), preset=9)
                )
            else:
                print(*table(name, today), sep="\n", flush=True)


def table(name: str, today: Mapping[str, Any], most: int = 20) -> list[str]:
    """Return lines on how today's answers differ from a record: the summary of its kind, and the first of what differs."""
    kept, found = load(name), difference(name, today)
    lines = [
        f"{name}: {len(found)} answers differ by more than the record's tolerance; "
        f"{len(kept.keys() - today.keys())} of {len(kept)} sets are not compared"
    ]
    lines += {"accuracy": _accuracy, "missions": _missions}.get(name, lambda *_: [])(kept, today)
    lines += [f"  {' / '.join(one.at)}: {one.kept} -> {one.today}" for one in found[:most]]
    return lines + ([f"  and {len(found) - most} more"] if len(found) > most else [])


def _accuracy(kept: Mapping[str, Any], today: Mapping[str, Any]) -> list[str]:
    """Return a line for each set and figure: today's means, and their differences, of scores the ratios, by number of profiles."""
    lines = []
    for sea, found in today.items():
        counts = {count: kept[sea][count] for count in found}
        before, after = pings.means(counts), pings.means(found)
        for figure in pings.FIGURES:
            pairs = [
                (now, now / old if "crps" in figure else now - old)
                for old, now in zip(before[figure], after[figure], strict=True)
                if old is not None and now is not None
            ]
            shown = " ".join(f"{now:.4f} ({change:.4f})" for now, change in pairs)
            lines.append(f"  {sea} {figure}: {shown}")
    return lines


def _missions(kept: Mapping[str, Any], today: Mapping[str, Any]) -> list[str]:
    """Return a line for each set: how many are reached, and today's hours over those kept of what both reach."""
    lines = []
    for name, found in today.items():
        pairs = [(kept[name][number], row) for number, row in found.items()]
        before, after = (sum(pair[k]["status"] == "reached" for pair in pairs) for k in (0, 1))
        ratio = [
            now["hours"] / old["hours"]
            for old, now in pairs
            if old["status"] == now["status"] == "reached"
        ]
        spread = "{1:.4f} ({0:.4f} to {2:.4f})".format(*np.quantile(ratio or [np.nan], [0, 0.5, 1]))
        lines.append(f"  {name}: reached {before} -> {after}; hours over those kept {spread}")
    return lines


if __name__ == "__main__":
    main()
