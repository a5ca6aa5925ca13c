"""Whether a result can be reproduced: its inputs are replayed, or planned on, with its configuration; the first difference is reported.

The result of a replay holds digests of its messages every few hours of log time; the repeated run stops at the first that differs.
"""

import json
import re
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, version
from itertools import groupby, islice
from pathlib import Path
from typing import Any

from rich.console import Console

from replay_kit.config.option import PLACE, numbers
from replay_kit.config.run import RunConfig, load_config
from replay_kit.core.errors import LogError
from replay_kit.core.plan import Place
from replay_kit.core.progress import Progress, silent
from replay_kit.core.version import __version__
from replay_kit.forecast.remote.kept import CACHE
from replay_kit.results.compare import Difference, Recorded, first_difference, read_recorded
from replay_kit.results.schemas import CONTRACT_VERSION
from replay_kit.results.topics import SUMMARY_NAME, Digest
from replay_kit.results.vehicles import vehicle_records
from replay_kit.workflows.replay.inputs.job import ReplayJob, Vehicle
from replay_kit.workflows.replay.inputs.provenance import (
    BATHYMETRY,
    FOLLOWED,
    PLAN_RECORD,
    PROVIDED,
    file_hash,
    with_bathymetry,
)
from replay_kit.workflows.replay.inputs.region import REGION_RECORD, from_record
from replay_kit.workflows.replay.replay import replay
from replay_kit.workflows.replay.scoring import RIVAL
from replay_kit.workflows.replay.stages.planner import PlannerFactory

_VERSIONS = "replay_kit.versions"
_VALUES_SHOWN = 10

#: Plans again what a result records, with its configuration and its inputs by their keys, and writes the plan's result.
PlanAgain = Callable[[Recorded, RunConfig, Mapping[str, Path], Path], None]


@dataclass(frozen=True, slots=True)
class Verdict:
    """Comparison of a result with its repetition.

    Attributes:
        result: The result.
        messages: Number of messages that are the same.
        difference: The first message that differs; None when none does.
        others: Attachments and metadata records that differ, of these the values: recorded, then made again.
        notes: What may explain a difference: other versions, a limit of time.
    """

    result: Path
    messages: int
    difference: Difference | None
    others: tuple[str, ...]
    notes: tuple[str, ...]

    @property
    def same(self) -> bool:
        """Whether the result was reproduced bit for bit."""
        return self.difference is None and not self.others


class _DivergedError(Exception):
    """The repetition gave another digest."""


def verify(
    result: Path,
    folders: Sequence[Path],
    planner_of: PlannerFactory,
    progress: Progress = silent,
    plan_again: PlanAgain | None = None,
) -> Verdict:
    """Return the comparison of a result with a new replay, or a new plan, of its inputs with its configuration.

    Args:
        result: A result of ``replay`` or ``plan``.
        folders: Where the inputs are looked for, by name and content; then beside the result, then here.
        planner_of: Makes the planner of a configuration.
        progress: Called with how much is done of each stage.
        plan_again: Makes the result of a plan again; needed for one alone.

    Raises:
        LogError: The result cannot be read or does not say what it was made from, or an input is not found.
    """
    recorded = read_recorded(result)
    if recorded.metadata.get("replay_kit.options", {}).get("smoothed"):
        raise LogError(
            f"{result}: expected a result of replay-kit replay, got a smoothed one; verify the replay, and smooth again"
        )
    if provided := recorded.metadata.get("replay_kit.options", {}).get(PROVIDED):
        raise LogError(
            f"{result}: expected a result of files and settings alone, got one whose {provided} a script gave; run the script again"
        )
    planned = not any(key.startswith("ensemble") for key in recorded.metadata["replay_kit.inputs"])
    if planned and PLAN_RECORD not in recorded.metadata:
        raise LogError(
            f"{result}: a plan of an earlier version, which records no options to make it again from; plan again to verify"
        )
    with tempfile.TemporaryDirectory() as folder:
        settings = Path(folder) / "config.toml"
        settings.write_text(recorded.config_toml, encoding="utf-8")
        config = load_config(settings)
        again = Path(folder) / "again.mcap"
        found = _inputs(result, recorded, [*folders, result.parent, Path(), CACHE])
        if planned:
            assert plan_again is not None, "the result of a plan needs plan_again"
            plan_again(recorded, config, found, again)
            made, difference = read_recorded(again).digests[-1].messages, None
        else:
            if BATHYMETRY in found:
                config = with_bathymetry(config, found[BATHYMETRY])
            made, difference = _replay_again(
                result, recorded, _job(recorded, found, again), config, planner_of, progress
            )
        others: tuple[str, ...] = ()
        if difference is None:
            difference = first_difference(result, again, definitions=_same_contract(recorded))
            others = _others_that_differ(recorded, read_recorded(again))
    return Verdict(
        result,
        difference.index if difference else made,
        difference,
        others,
        _what_may_differ(recorded),
    )


def _replay_again(
    result: Path,
    recorded: Recorded,
    job: ReplayJob,
    config: RunConfig,
    planner_of: PlannerFactory,
    progress: Progress,
) -> tuple[int, Difference | None]:
    """Replay a result's inputs; return the number of messages made, and the difference at which it stopped, None when it is whole."""
    made, stopped = _repeat(job, config, planner_of, recorded.digests, progress)
    if stopped is None:
        return made, None
    assert job.out is not None, "what is compared is a file"
    unfinished = job.out.with_name(job.out.name + ".part")
    difference = first_difference(result, unfinished, stopped.messages, _same_contract(recorded))
    if difference is None:
        # the digest itself is what differs: nothing less than everything must be compared
        made, _ = _repeat(job, config, planner_of, (), progress)
    return made, difference


def _same_contract(recorded: Recorded) -> bool:
    """Return whether a result has this version's contract; another names fields otherwise, but their bytes can be compared."""
    return _contract(recorded) == str(CONTRACT_VERSION)


def _others_that_differ(one: Recorded, other: Recorded) -> tuple[str, ...]:
    """Return attachments and metadata records that are not the same, but for versions and what a truth is scored with."""
    # results of earlier versions have no summary
    made = {
        name: data
        for name, data in other.attachments.items()
        if name != SUMMARY_NAME or name in one.attachments
    }
    attachments = [f"attachment {name}" for name in _unequal(one.attachments, made)]
    ours, theirs = (
        {name: _without_truth(values) for name, values in recorded.metadata.items()}
        for recorded in (one, other)
    )
    # how a log grew is not repeated: its final files are replayed at once
    ignored = (
        {_VERSIONS, FOLLOWED}
        if _contract(one) == _contract(other)
        else {_VERSIONS, FOLLOWED, "contract"}
    )
    metadata: list[str] = []
    for name in _unequal(ours, theirs):
        if name not in ignored:
            found = _values_that_differ(ours.get(name), theirs.get(name), f"metadata {name}")
            metadata += list(islice(found, _VALUES_SHOWN)) or [f"metadata {name}"]
    digests = ["the digests"] if one.digests != other.digests else []
    return (*attachments, *metadata, *digests)


def _contract(recorded: Recorded) -> str | None:
    """Return the version of the contract of a result."""
    return recorded.metadata.get("contract", {}).get("version")


def _unequal(one: Mapping[str, Any], other: Mapping[str, Any]) -> list[str]:
    return sorted(name for name in one.keys() | other.keys() if one.get(name) != other.get(name))


def _values_that_differ(one: object, other: object, path: str) -> Iterator[str]:
    """Yield the path and both values of everything that differs; a text that is JSON is looked into."""
    with suppress(ValueError, TypeError):
        one, other = json.loads(one), json.loads(other)  # type: ignore[arg-type]
    if isinstance(one, list) and isinstance(other, list) and len(one) == len(other):
        one, other = dict(enumerate(one)), dict(enumerate(other))
    if isinstance(one, dict) and isinstance(other, dict):
        for key in _unequal(one, other):
            yield from _values_that_differ(one.get(key), other.get(key), f"{path}: {key}")
    # not-a-number is taken for itself
    elif repr(one) != repr(other):
        yield f"{path}: {'none' if one is None else one} | {'none' if other is None else other}"


def _without_truth(values: Mapping[str, str]) -> dict[str, str]:
    return {key: value for key, value in values.items() if key not in ("truth", "truth_radius_km")}


def _repeat(
    job: ReplayJob,
    config: RunConfig,
    planner_of: PlannerFactory,
    expected: Sequence[Digest],
    progress: Progress,
) -> tuple[int, Digest | None]:
    """Replay until a digest differs; return the number of messages made, and that digest, None when all are the same.

    Without expected digests there is nothing to stop at.
    """
    made, other = 0, None
    remaining = list(expected)

    def compare(digest: Digest) -> None:
        nonlocal made, other
        made = digest.messages
        if expected and (not remaining or remaining.pop(0) != digest):
            other = digest
            raise _DivergedError

    with suppress(_DivergedError):
        replay(job, config, planner_of, progress, compare)
    return made, other


def _inputs(result: Path, recorded: Recorded, folders: Sequence[Path]) -> dict[str, Path]:
    """Return the inputs that a result names, by their keys."""
    return {
        key: _find(result, key, text, folders)
        for key, text in recorded.metadata["replay_kit.inputs"].items()
    }


def _products(found: Mapping[str, Path], prefix: str) -> tuple[tuple[Path, ...], ...]:
    """Return the files whose keys begin so, by products: files of one have its number first."""
    keys = [key for key in sorted(found, key=_numbers) if key.startswith(prefix)]
    each = groupby(keys, lambda key: key.partition("_")[0])
    return tuple(tuple(found[key] for key in of_one) for _, of_one in each)


def _place(text: str | None) -> Place | None:
    return Place(*numbers(text, "goal", PLACE.form)) if text else None


def _job(recorded: Recorded, found: Mapping[str, Path], out: Path) -> ReplayJob:
    options = recorded.metadata.get("replay_kit.options", {})
    logs = tuple(found[key] for key in sorted(found, key=_numbers) if key.startswith("log"))
    ensemble, against = (_products(found, prefix) for prefix in ("ensemble", RIVAL))
    where = _place(options.get("goal"))
    record = recorded.metadata.get(REGION_RECORD)
    region = None if record is None else from_record(record)
    included = options.get("include_inputs") == "true"
    vehicles = tuple(
        Vehicle(
            one.name,
            tuple(found[key] for key in one.logs),
            _place(one.goal),
            one.why_not,
        )
        for one in vehicle_records(recorded.metadata)
    )
    return ReplayJob(
        logs,
        ensemble,
        out,
        goal=where,
        include_inputs=included,
        region=region,
        against=against,
        vehicles=vehicles,
    )


def _numbers(key: str) -> list[int]:
    """Return the numbers in an input's key, by which inputs are in their order."""
    return [int(number) for number in re.findall(r"\d+", key)]


def _find(result: Path, key: str, recorded: str, folders: Sequence[Path]) -> Path:
    """Return the input of a recorded name and hash."""
    name, _, digest = recorded.rpartition(" sha256:")
    others = []
    for folder in folders:
        if (path := folder / name).exists():
            if file_hash(path) == digest:
                return path
            others.append(str(path))
    what = f"found only other contents: {', '.join(others)}" if others else "there is none"
    raise LogError(
        f"{result}: its input {key} is {name} with SHA-256 {digest[:12]}...; {what}; say with --inputs in which folder it is"
    )


def _what_may_differ(recorded: Recorded) -> tuple[str, ...]:
    """Say what may make another result: packages that are not those it was made with, and a search that the clock stopped."""
    notes = []
    if "time_limit" in recorded.metadata.get("replay_kit.options", {}):
        notes.append(
            "planned with --time-limit: a search that the clock stops may find another plan"
        )
    if (version_then := _contract(recorded)) != str(CONTRACT_VERSION):
        notes.append(
            f"made with contract version {version_then}, here it is {CONTRACT_VERSION}: names of fields were not compared"
        )
    for package, made_with in recorded.metadata.get(_VERSIONS, {}).items():
        try:
            here = __version__ if package == "replay-kit" else version(package)
        except PackageNotFoundError:
            here = "none"
        if here != made_with:
            notes.append(
                f"made with {package} {made_with}, here it is {here}: last bits may differ"
            )
    return tuple(notes)


def verdict_json(verdict: Verdict) -> dict[str, Any]:
    """Return the JSON object of ``--json``."""
    return {**asdict(verdict), "result": str(verdict.result), "same": verdict.same}


def print_verdict(verdict: Verdict, console: Console) -> None:
    """Print whether the result was made again, or where not."""
    if verdict.same:
        console.print(f"{verdict.result}: made again bit for bit, {verdict.messages} messages")
    if (first := verdict.difference) is not None:
        console.print(
            f"{verdict.result}: message {first.index} differs: {first.topic} at {first.time_ns} ns",
        )
        for field in first.fields:
            console.print(f"  {field}  (recorded | made again)")
    for name in verdict.others:
        console.print(f"{verdict.result}: differs: {name}")
    for note in verdict.notes:
        console.print(f"note: {note}")
