"""Comparison of two results by value: inputs and settings, estimate, tables, findings; bytes and hashes are ignored."""

import json
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from operator import attrgetter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from replay_kit.core.errors import LogError
from replay_kit.results.mcap.topics import CONFIG_NAME
from replay_kit.results.outcome.outcome import leaves
from replay_kit.results.reader import ResultReader
from replay_kit.results.result import ResultFile

#: Values are the same to this, of themselves where they are above 1.
TOLERANCE = 1e-9
_TABLES = ("fixes", "observations", "innovations", "surface", "surfacings", "plans", "plan_tracks")
# records of a plan, each value JSON
_PLANNED = ("legs", "departures")
# what of a run may differ without a difference of its values
_OF_MAKING = ("settings.", "replay_kit.inputs", "replay_kit.options", "replay_kit.versions")


class Recorded(NamedTuple):
    """Record of the run that made a result.

    Attributes:
        metadata: Record name to keys and values, without digests.
        config_toml: Configuration.
    """

    metadata: dict[str, dict[str, str]]
    config_toml: str


@dataclass(frozen=True, slots=True)
class LevelDifference:
    """Difference of two estimates at a level, over the nodes of their grid.

    Attributes:
        depth: Depth of the level [m].
        rms: RMS difference of a component [m/s].
        largest: Largest difference of a component [m/s].
        standard_error: Largest difference of the standard errors [m/s].
    """

    depth: float
    rms: float
    largest: float
    standard_error: float


@dataclass(frozen=True, slots=True)
class TableDifference:
    """Difference of two tables.

    Attributes:
        name: Name of the table, with the vehicle's name as prefix if there are several.
        rows: Number of rows of both.
        columns: Largest difference by column in its unit, or number of unequal texts and flags; empty if the numbers of rows differ.
    """

    name: str
    rows: tuple[int, int]
    columns: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class Difference:
    """Difference between two results.

    Attributes:
        made: Different inputs, settings and versions, with both values; they alone do not count as a difference.
        estimate: Different levels.
        tables: Different tables.
        findings: Different legs, findings, verdicts and exit codes.
    """

    made: tuple[str, ...]
    estimate: tuple[LevelDifference, ...]
    tables: tuple[TableDifference, ...]
    findings: tuple[str, ...]

    @property
    def same(self) -> bool:
        """Whether all values are equal."""
        return not (self.estimate or self.tables or self.findings)

    def to_json(self) -> dict[str, Any]:
        """Return the JSON object of ``--json``."""
        return {"same": self.same, **asdict(self)}

    def __str__(self) -> str:
        """Return a line per difference."""
        return "\n".join([*self.made, *self._values()])

    def _values(self) -> Iterator[str]:
        if self.same:
            yield "the same values"
        for one in self.estimate:
            rms, most, error = (100.0 * v for v in (one.rms, one.largest, one.standard_error))
            yield (
                f"estimate at {one.depth:g} m: RMS {rms:.2g}, at most {most:.2g} cm/s; standard error at most {error:.2g} cm/s"
            )
        for name, (rows, others), columns in map(
            attrgetter("name", "rows", "columns"), self.tables
        ):
            yield from [f"table {name}: {rows} | {others} rows"] * (rows != others)
            for column, off in columns.items():
                said = (
                    f"differs by {off:.3g}" if off < np.inf else "has values that one of them lacks"
                )
                yield f"table {name}: {column} {said}"
        yield from self.findings


def read_recorded(path: Path) -> Recorded:
    """Return the record of the run that made a result.

    Raises:
        LogError: It cannot be read, or is the result of neither a replay nor a plan.
    """
    return _recorded(ResultReader(path))


def _recorded(reader: ResultReader) -> Recorded:
    """Return the record of an open result."""
    metadata, config = reader.metadata, reader.text(CONFIG_NAME)
    # a replay has an ensemble, a plan made on its own estimates
    inputs = metadata.get("replay_kit.inputs", {})
    known = any(key.startswith(("ensemble", "flow")) for key in inputs)
    if not config or not known:
        lacking = "replay_kit.inputs: ensemble or flow0" if config else CONFIG_NAME
        raise LogError(
            f"{reader.path}: expected a whole result of replay-kit replay or plan, but it has no {lacking}; give the file of --out"
        )
    return Recorded(metadata, config)


def difference(one: Path, other: Path) -> Difference:
    """Return the difference between two results.

    Args:
        one: Result of a replay or a plan.
        other: Another result.

    Raises:
        LogError: A result cannot be read, or versions, vehicles, regions or periods are not comparable.
    """
    files = ResultFile(one), ResultFile(other)
    records = [_recorded(each.reader) for each in files]
    versions = [each.metadata["contract"]["version"] for each in records]
    vehicles = [[vehicle.name for vehicle in each.reader.vehicles] or [""] for each in files]
    named = [", ".join(names) or "a single one" for names in vehicles]
    for what, (a, b) in (("contract version", versions), ("vehicles", named)):
        if a != b:
            raise LogError(f"{one} and {other}: expected the same {what}, got {a} and {b}")
    tables, findings = list[TableDifference](), list[str]()
    for name in vehicles[0]:
        parts = [ResultFile(each.path, vehicle=name, opened=each.reader.file) for each in files]
        tables += _tables(name, *parts)
        findings += [f"{name}: {text}".removeprefix(": ") for text in _changes(*map(_found, parts))]
    made = tuple(_changes(*map(_made, records)))
    return Difference(made, tuple(_levels(*files)), tuple(tables), tuple(findings))


def _changes(one: Mapping[str, Any], other: Mapping[str, Any]) -> Iterator[str]:
    """Yield the values that differ by name, numbers by more than the tolerance."""
    for name in sorted(one.keys() | other.keys()):
        x, y = one.get(name, "none"), other.get(name, "none")
        numbers = isinstance(x, float) and isinstance(y, float)
        if x != y and not (numbers and abs(x - y) <= TOLERANCE * max(abs(x), 1.0)):
            yield f"{name}: {x} | {y}"


def _made(recorded: Recorded) -> dict[str, Any]:
    """Return the inputs, options, settings and versions of a run."""
    found = leaves({"settings": tomllib.loads(recorded.config_toml), **recorded.metadata})
    return {name: value for name, value in found if name.startswith(_OF_MAKING)}


def _found(result: ResultFile) -> dict[str, Any]:
    """Return legs, departures, findings, verdict and exit codes of a run."""
    records, outcome = result.reader.metadata, result.outcome
    planned = {
        f"{record}: {path}": value
        for record in _PLANNED
        for key, text in records.get(record, {}).items()
        for path, value in leaves(json.loads(text), key)
    }
    names = [one["name"] for one in outcome.consistency]
    return {
        **planned,
        "finding": ", ".join(names) or "none",
        "verdict": outcome.verdict.word,
        "exit code": ", ".join(map(str, outcome.exit_codes)) or "none",
    }


def _levels(one: ResultFile, other: ResultFile) -> Iterator[LevelDifference]:
    """Yield the levels at which estimates differ, window by window; nothing for results of plans alone.

    Raises:
        LogError: Regions or periods differ.
    """
    if not (one.has_estimate or other.has_estimate):
        return
    for a, b in zip(one.estimates, other.estimates, strict=False):
        axes = [attrgetter("longitude", "latitude", "levels")(each.grid) for each in (a, b)]
        alike = all(
            x.shape == y.shape and np.allclose(x, y, rtol=0.0, atol=1e-6)
            for x, y in zip(*axes, strict=True)
        )
        if not alike or len(one.estimates) != len(other.estimates) or a.span_ns != b.span_ns:
            what = "period" if alike and a.span_ns != b.span_ns else "grid"
            raise LogError(
                f"{one.path} and {other.path}: expected estimates of one {what}, got two; replay both with the same --region, --levels, "
                "--start and --end"
            )
        at = a.grid.east.ravel(), a.grid.north.ravel()
        for depth in a.levels.tolist():
            off, error = a.velocity(*at, depth) - b.velocity(*at, depth), np.zeros(1)
            if a.n_modes and b.n_modes:
                error = np.nan_to_num(a.standard_error(*at, depth) - b.standard_error(*at, depth))
            rms, *most = np.sqrt(np.mean(off**2)), np.abs(off).max(), np.abs(error).max()
            if max(most) > TOLERANCE:
                yield LevelDifference(depth, float(rms), *map(float, most))


def _tables(vehicle: str, one: ResultFile, other: ResultFile) -> Iterator[TableDifference]:
    for name in _TABLES:
        a, b = (getattr(each, name).reset_index() for each in (one, other))
        same = [column for column in a if column in b and len(a) == len(b)]
        each = {str(column): _column_difference(a[column], b[column]) for column in same}
        columns = {column: value for column, value in each.items() if value > 0.0}
        if columns or len(a) != len(b):
            yield TableDifference(f"{vehicle} {name}".strip(), (len(a), len(b)), columns)


def _column_difference(one: Any, other: Any) -> float:
    """Return the largest difference of two columns beyond the tolerance, times in seconds; for texts and flags the unequal rows."""
    if one.dtype.kind in "mM":
        return float((one - other).dt.total_seconds().abs().max() if len(one) else 0.0)
    if one.dtype.kind not in "fiu" or other.dtype.kind not in "fiu":
        a, b = (each.astype(object).where(each.notna(), "").astype(str) for each in (one, other))
        return float((a != b).sum())
    a, b = one.to_numpy(np.float64), other.to_numpy(np.float64)
    with np.errstate(invalid="ignore"):
        off = np.nan_to_num(np.abs(a - b), nan=np.inf, posinf=np.inf)
    beyond = off > TOLERANCE * np.maximum(np.nan_to_num(np.abs(a)), 1.0)
    alike = (a == b) | (np.isnan(a) & np.isnan(b))
    return float(off[beyond & ~alike].max(initial=0.0))
