"""Reproduction of a result: its inputs are replayed or planned on with its configuration, and the values compared."""

import re
import tempfile
from collections.abc import Callable, Mapping, Sequence
from itertools import groupby
from pathlib import Path

from replay_kit.config.option import PLACE, numbers
from replay_kit.config.run import RunConfig, load_config
from replay_kit.core.errors import LogError
from replay_kit.core.plan import Place
from replay_kit.core.words.progress import Progress, silent
from replay_kit.forecast.remote.kept import CACHE
from replay_kit.results.differences import Difference, Recorded, difference, read_recorded
from replay_kit.results.reader import vehicle_records
from replay_kit.workflows.replay.inputs.job import ReplayJob, Vehicle
from replay_kit.workflows.replay.inputs.planner import PlannerFactory
from replay_kit.workflows.replay.inputs.provenance import (
    BATHYMETRY,
    PLAN_RECORD,
    PROVIDED,
    RIVAL,
    input_hash,
    with_bathymetry,
)
from replay_kit.workflows.replay.inputs.region import REGION_RECORD, from_record
from replay_kit.workflows.replay.replay import replay

#: Plans again what a result records, with its configuration and its inputs by their keys, and writes the plan's result.
PlanAgain = Callable[[Recorded, RunConfig, Mapping[str, Path], Path], None]


def verify(
    result: Path,
    folders: Sequence[Path],
    planner_of: PlannerFactory,
    progress: Progress = silent,
    plan_again: PlanAgain | None = None,
) -> Difference:
    """Return the comparison of a result with a repeated replay or plan of its inputs with its configuration.

    Args:
        result: Result of ``replay`` or ``plan``.
        folders: Folders to search for inputs by name and content, before those of the result and the working directory.
        planner_of: Factory of the planner.
        progress: Called with the progress of each stage.
        plan_again: Repeats a plan; required for results of ``plan`` only.

    Raises:
        LogError: The result is unreadable or does not state its inputs, or an input is not found.
    """
    recorded = read_recorded(result)
    inputs, options = (
        recorded.metadata.get(name, {}) for name in ("replay_kit.inputs", "replay_kit.options")
    )
    planned = not any(key.startswith("ensemble") for key in inputs)
    why_not = (
        "got a smoothed one; verify the replay, and smooth again"
        if options.get("smoothed")
        else f"got one whose {options[PROVIDED]} a script gave; run the script again"
        if options.get(PROVIDED)
        else "got a plan of an earlier version, which records no options to make it again from; plan again"
        if planned and PLAN_RECORD not in recorded.metadata
        else ""
    )
    if why_not:
        raise LogError(f"{result}: expected a result of replay-kit replay or plan, {why_not}")
    searched = [*folders, result.parent, Path(), CACHE]
    found = {key: _find(result, key, text, searched) for key, text in inputs.items()}
    with tempfile.TemporaryDirectory() as folder:
        settings, again = Path(folder) / "config.toml", Path(folder) / "again.mcap"
        settings.write_text(recorded.config_toml, encoding="utf-8")
        config = load_config(settings)
        if planned:
            assert plan_again is not None, "the result of a plan needs plan_again"
            plan_again(recorded, config, found, again)
        else:
            if BATHYMETRY in found:
                config = with_bathymetry(config, found[BATHYMETRY])
            replay(_job(recorded, found, again), config, planner_of, progress)
        return difference(result, again)


def _products(found: Mapping[str, Path], prefix: str) -> tuple[tuple[Path, ...], ...]:
    """Return the files with keys of a prefix, grouped by product: keys of one product begin with its number."""
    keys = [key for key in sorted(found, key=_numbers) if key.startswith(prefix)]
    each = groupby(keys, lambda key: key.partition("_")[0])
    return tuple(tuple(found[key] for key in of_one) for _, of_one in each)


def _place(text: str | None) -> Place | None:
    return Place(*numbers(text, "goal", PLACE.form)) if text else None


def _job(recorded: Recorded, found: Mapping[str, Path], out: Path) -> ReplayJob:
    """Return the job recorded in a replay's result."""
    options, region = (
        recorded.metadata.get(name, {}) for name in ("replay_kit.options", REGION_RECORD)
    )
    return ReplayJob(
        tuple(found[key] for key in sorted(found, key=_numbers) if key.startswith("log")),
        _products(found, "ensemble"),
        out,
        goal=_place(options.get("goal")),
        include_inputs=options.get("include_inputs") == "true",
        region=from_record(region) if region else None,
        against=_products(found, RIVAL),
        vehicles=tuple(
            Vehicle(one.name, tuple(found[key] for key in one.logs), _place(one.goal), one.why_not)
            for one in vehicle_records(recorded.metadata)
        ),
    )


def _numbers(key: str) -> list[int]:
    """Return the numbers in an input's key, which give the order of inputs."""
    return [int(number) for number in re.findall(r"\d+", key)]


def _find(result: Path, key: str, recorded: str, folders: Sequence[Path]) -> Path:
    """Return the input with a recorded name and hash."""
    name, _, digest = recorded.rpartition(" sha256:")
    others = []
    # a folder is an input too, as the segments of a glider
    places = [path for folder in folders for path in (folder / name, folder) if path.name == name]
    for path in places:
        if path.exists():
            if input_hash(path) == digest:
                return path
            others.append(str(path))
    what = f"found only other contents: {', '.join(others)}" if others else "there is none"
    raise LogError(
        f"{result}: its input {key} is {name} with SHA-256 {digest[:12]}...; {what}; give its folder with --inputs"
    )
