"""Reader of a result, or of one vehicle's part: records, attachments and messages.

A reader of one vehicle's part uses the names of a single-vehicle result (``vehicles.py``).
"""

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from mcap.records import Attachment, Schema
from mcap_protobuf.decoder import DecoderFactory

from replay_kit.core.errors import ForecastError, LogError
from replay_kit.core.grid import Projection
from replay_kit.results.mcap.topics import (
    CONFIG_NAME,
    DIGEST_NAME,
    EARLIER_ESTIMATE,
    ESTIMATE_NAME,
    SUMMARY_NAME,
    WINDOW_NAME,
    WINDOWS_RECORD,
    OpenResult,
    message_counts,
    naming_errors,
    topic_of,
)
from replay_kit.results.outcome.outcome import Outcome, outcome_from

if TYPE_CHECKING:
    from mcap.summary import Summary

    from replay_kit.core.flow.estimate import FlowEstimate


#: Record of a result of several vehicles: name to logs and goal, as JSON.
VEHICLES_RECORD = "replay_kit.vehicles"
#: Names that no vehicle may have, as topics begin with them.
RESERVED = ("flow", "input", "log", "plan", "tf", "vehicle")


class VehicleRecord(NamedTuple):
    """Record of one vehicle in a result of several.

    Attributes:
        name: Name of the vehicle.
        logs: Keys of its logs among the inputs.
        goal: Goal as in the option; empty without one.
        why_not: Why its measurements were not used; else empty.
    """

    name: str
    logs: tuple[str, ...]
    goal: str = ""
    why_not: str = ""

    def to_text(self) -> str:
        """Return the text of the record."""
        return json.dumps({"logs": self.logs, "goal": self.goal, "why_not": self.why_not})


def vehicle_records(metadata: Mapping[str, Mapping[str, str]]) -> tuple[VehicleRecord, ...]:
    """Return the vehicles in a result's metadata in order of their names; empty for a single vehicle."""
    held = sorted(metadata.get(VEHICLES_RECORD, {}).items())
    parts = [(name, json.loads(text)) for name, text in held]
    return tuple(VehicleRecord(name, **one | {"logs": tuple(one["logs"])}) for name, one in parts)


def part_path(path: Path, vehicle: str, folder: Path) -> Path:
    """Return the file of one vehicle in a folder, such as ``out.sg1.mcap`` for ``out.mcap``."""
    return folder / f"{path.stem}.{vehicle}{path.suffix}"


_INPUTS, _OPTIONS = "replay_kit.inputs", "replay_kit.options"
# The first contract version that is read, of 0.3.
_OLDEST = 5
# Of one of several vehicles and of all.
_COMMON = ("/tf", "/log")


@dataclass(frozen=True)
class ResultReader:
    """Result MCAP, or one vehicle's part of it.

    Attributes:
        path: Result file.
        vehicle: Name of one of its vehicles; empty for the whole result.
        opened: The file, if open.

    Raises:
        LogError: From each attribute and method: the file is missing or no complete result.
    """

    path: Path
    vehicle: str = ""
    opened: OpenResult | None = field(default=None, compare=False, repr=False)

    @cached_property
    def file(self) -> OpenResult:
        """Open file, common to all vehicles."""
        return self.opened or OpenResult(self.path)

    def part(self, vehicle: str) -> "ResultReader":
        """Return the part of a vehicle; the whole for an empty name."""
        return ResultReader(self.path, vehicle, self.file)

    @property
    def name(self) -> str:
        """Name of the file, with the vehicle's name for a part."""
        return part_path(self.path, self.vehicle, Path()).name if self.vehicle else self.path.name

    @property
    def summary(self) -> "Summary":
        """Summary of the whole file."""
        return self.file.summary

    @cached_property
    def topics(self) -> dict[str, int]:
        """Number of messages by topic, of the whole file."""
        return message_counts(self.summary)

    @property
    def records(self) -> list[tuple[str, dict[str, str]]]:
        """Metadata records of the whole file, in order, with their names."""
        return self.file.records

    @cached_property
    def metadata(self) -> dict[str, dict[str, str]]:
        """Records by name, without digests; for a vehicle its own and the common ones, with its logs and goal alone."""
        if not self.vehicle:
            return {name: values for name, values in self.records if name != DIGEST_NAME}
        split = [(*full.rpartition("/")[::2], values) for full, values in self.records]
        found = {name: values for owner, name, values in split if owner in ("", self.vehicle)}
        for name in (DIGEST_NAME, VEHICLES_RECORD):
            found.pop(name, None)
        (record,) = (one for one in vehicle_records(dict(self.records)) if one.name == self.vehicle)
        inputs = found.get(_INPUTS, {}).items()
        kept = {k: text for k, text in inputs if not k.startswith("log") or k in record.logs}
        return found | {_INPUTS: kept, _OPTIONS: {**found.get(_OPTIONS, {}), "goal": record.goal}}

    @property
    def projection(self) -> Projection:
        """The local frame."""
        frame = self.metadata["frame map"]
        return Projection(float(frame["longitude"]), float(frame["latitude"]))

    @cached_property
    def vehicles(self) -> tuple[VehicleRecord, ...]:
        """Vehicles of the result in order of their names; empty for a single vehicle or a part."""
        return vehicle_records(self.metadata)

    def attachments(self, wanted: Callable[[str], bool]) -> dict[str, Attachment]:
        """Return the attachments with wanted names, as in a single-vehicle result."""
        windows: Mapping[str, str] = self.metadata.get(WINDOWS_RECORD, {})
        number = json.loads(windows.get("vehicles", "{}")).get(self.vehicle)
        window = f"{WINDOW_NAME}{number}"
        found = dict[str, Attachment]()
        for entry in self.summary.attachment_indexes:
            owner, _, name = entry.name.rpartition("/")
            if (
                self.vehicle
                and owner != self.vehicle
                and not (name == CONFIG_NAME or name.startswith("estimate"))
            ):
                continue
            if not self.vehicle:
                name = entry.name
            stem, dot, ending = name.partition(".")
            if number and stem in ("estimate", window):
                # so that the last one is that of the vehicle's window
                name = f"{window if stem == 'estimate' else 'estimate'}{dot}{ending}"
            if wanted(name):
                found[name] = self.file.attachment(entry.offset)
        return found

    @cached_property
    def outcome(self) -> Outcome | None:
        """Outcome of the run, or of the vehicle; None if not stored, as in an unfinished run."""
        held = self.part("").attachments(lambda name: name.rpartition("/")[2] == SUMMARY_NAME)
        with naming_errors(self.path):
            records = {name.rpartition("/")[0]: json.loads(one.data) for name, one in held.items()}
            if (record := records.pop("", None)) is None:
                return None
            # results of earlier versions keep one of each vehicle beside that of all
            whole = record if record.get("vehicles") else record | {"vehicles": records}
            found = outcome_from(whole)
        return found.vehicles.get(self.vehicle) if self.vehicle else found

    def text(self, name: str) -> str:
        """Return an attached text; empty if missing."""
        return "".join(one.data.decode() for one in self.attachments(name.__eq__).values())

    def _own(self, topic: str) -> set[str]:
        return {topic_of(self.vehicle, topic)} | ({topic} if topic in _COMMON else set())

    def messages(
        self, topic: str, newest: bool = False, until_ns: int | None = None
    ) -> Iterator[tuple[int, bytes]]:
        """Yield time [ns, UTC] and payload of the messages of a topic, forward or backward from ``until_ns``."""
        if newest:
            return self.file.newest(self._own(topic), until_ns)
        return self.file.messages(self._own(topic))

    def schema(self, topic: str) -> Schema | None:
        """Return the schema of a topic; None without messages."""
        topics = self._own(topic)
        kinds = (one.schema_id for one in self.summary.channels.values() if one.topic in topics)
        return next((self.summary.schemas[kind] for kind in kinds), None)

    def decoded(self, topic: str, newest: bool = False, until_ns: int | None = None) -> Any:
        """Yield time [ns, UTC] and message, decoded by the descriptors of the file; see ``messages``.

        Raises:
            LogError: A log was merged into the result.
        """
        if (schema := self.schema(topic)) is None:
            return iter(())
        decode = DecoderFactory().decoder_for("protobuf", schema)
        if decode is None:
            raise LogError(
                f"{self.path}: expected protobuf on {topic}, got {schema.encoding}: a log was merged into the result; give the result alone"
            )
        return ((at, decode(data)) for at, data in self.messages(topic, newest, until_ns))

    def estimate(self) -> "FlowEstimate":
        """Return the last estimate.

        Raises:
            ForecastError: The result has no estimate.
        """
        held = self.attachments(ESTIMATE_NAME.__eq__)
        if not held and self.attachments(EARLIER_ESTIMATE.__eq__):
            raise ForecastError(
                f"{self.path}: its estimate is of 0.3; export it with 0.3, or replay the log again"
            )
        if not held:
            raise ForecastError(
                f"{self.path}: carries no {ESTIMATE_NAME} (written without an estimate, unfinished, or a plan "
                "alone); its fixes, innovations and plans can be read, but no current: replay the log for an estimate"
            )
        return _estimate(self.path, held[ESTIMATE_NAME])

    def estimates(self) -> "tuple[FlowEstimate, ...]":
        """Return the estimates of all windows in order; the last one equals ``estimate``.

        Raises:
            ForecastError: See ``estimate``.
        """
        last, withdrawn = self.estimate(), self.metadata.get(WINDOWS_RECORD, {}).get("withdrawn", 0)
        left = {
            int(name.removeprefix(WINDOW_NAME).partition(".")[0]): one
            for name, one in self.attachments(lambda name: name.startswith(WINDOW_NAME)).items()
        }
        numbers = (number for number in sorted(left) if number > int(withdrawn))
        return (*(_estimate(self.path, left[number]) for number in numbers), last)


def check_result(reader: ResultReader) -> None:
    """Raise LogError if a file is no result of ``replay`` or ``plan``, or one of a contract before 0.3."""
    path, records = reader.path, reader.metadata
    if "contract" not in records or "frame map" not in records:
        raise LogError(
            f"{path}: an MCAP file, but no result of replay-kit (no metadata record 'contract'); open a log with open_log"
        )
    if (version := int(records["contract"]["version"])) < _OLDEST:
        raise LogError(
            f"{path}: expected a result of version 0.3.0 or later, got one of contract version {version}; replay the log again"
        )


def _estimate(path: Path, held: Attachment) -> "FlowEstimate":
    """Return the estimate in an attachment."""
    # here, because a status needs none of what holds an estimate
    from replay_kit.core.flow.file import unpack

    return unpack(held.data, f"{path}#{held.name}")
