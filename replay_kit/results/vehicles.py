"""Results of several vehicles with one estimate: the names of what is one vehicle's, and its part as a result of its own.

Topics, records and attachments of the estimate are those of any result. What is one vehicle's has its name before it: ``/sg1/fix`` stands
for ``/vehicle/fix``, ``/sg1/innovation`` for ``/flow/innovation``, ``/sg1/plan/path`` for ``/plan/path``, the attachment
``sg1/summary.json`` for ``summary.json``.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from mcap.reader import McapReader, make_reader
from mcap.records import Channel
from mcap.writer import CompressionType, Writer

from replay_kit.core.atomic import atomic_file
from replay_kit.results.topics import (
    CONFIG_NAME,
    DIGEST_NAME,
    EARLIER_ESTIMATE,
    ESTIMATE_NAME,
    WINDOW_NAME,
    WINDOWS_RECORD,
    complete,
)

#: Record of a result of several vehicles: name to logs and goal, as JSON.
VEHICLES_RECORD = "replay_kit.vehicles"
#: Record of one vehicle's part that was taken out of a result of several: its name.
VEHICLE_RECORD = "replay_kit.vehicle"
#: Names that no vehicle may have, as topics begin with them.
RESERVED = ("flow", "input", "log", "plan", "tf", "vehicle")
_SHARED = ("/flow/estimate", "/flow/grid/", "/flow/arrows/", "/flow/surface", "/plan/seabed")
_SHORT = {
    "/vehicle/fix": "fix",
    "/flow/innovation": "innovation",
    "/flow/consistency": "consistency",
    "/flow/surfacing": "surfacing",
}
_LONG = {short: topic for topic, short in _SHORT.items()}
_INPUTS, _OPTIONS = "replay_kit.inputs", "replay_kit.options"


@dataclass(frozen=True, slots=True)
class VehicleRecord:
    """What a result of several vehicles states of one.

    Attributes:
        name: The vehicle's.
        logs: Keys of its logs among the inputs.
        goal: As the option states it; empty without.
        why_not: Why it gave nothing to the estimate; empty for one that did.
    """

    name: str
    logs: tuple[str, ...]
    goal: str = ""
    why_not: str = ""

    def to_text(self) -> str:
        """Return it as a record keeps it."""
        return json.dumps({"logs": self.logs, "goal": self.goal, "why_not": self.why_not})


def vehicle_records(metadata: Mapping[str, Mapping[str, str]]) -> tuple[VehicleRecord, ...]:
    """Return the vehicles of a result by its metadata, in the order of their names; none where it is of one alone."""
    held = {name: json.loads(text) for name, text in metadata.get(VEHICLES_RECORD, {}).items()}
    return tuple(
        VehicleRecord(name, tuple(one["logs"]), one["goal"], one["why_not"])
        for name, one in sorted(held.items())
    )


def vehicles_in(path: Path) -> tuple[VehicleRecord, ...]:
    """Return the vehicles of a result; none where it is of one alone.

    Raises:
        LogError: The file is missing, or is no complete result.
    """
    with complete(path), path.open("rb") as file:
        metadata = make_reader(file).iter_metadata()
        return vehicle_records({record.name: record.metadata for record in metadata})


def topic_of(vehicle: str, topic: str) -> str:
    """Return the topic of a vehicle's messages: as it is for the only vehicle (an empty name), and for what is the estimate's."""
    if not vehicle or topic.startswith(_SHARED):
        return topic
    return f"/{vehicle}/{_SHORT.get(topic, topic[1:])}"


def name_of(vehicle: str, name: str) -> str:
    """Return the name of a vehicle's record or attachment; as it is for the only vehicle."""
    return f"{vehicle}/{name}" if vehicle else name


def part_path(path: Path, vehicle: str, folder: Path) -> Path:
    """Return the name of a file of one vehicle beside that of all, in a folder: ``out.sg1.mcap`` of ``out.mcap``."""
    return folder / f"{path.stem}.{vehicle}{path.suffix}"


def write_part(path: Path, vehicle: VehicleRecord, out: Path, estimate: bool = True) -> None:
    """Write one vehicle's part of a result, with the common estimate, as a result of its own.

    Args:
        path: The result of several vehicles.
        vehicle: One of them.
        out: Where to.
        estimate: Whether the estimate, its weights and slices are in it too.

    Raises:
        LogError: The file is missing, or is no complete result.
    """
    with complete(path), path.open("rb") as source, atomic_file(out) as target:
        reader, writer = make_reader(source), Writer(target, compression=CompressionType.NONE)
        writer.start(profile="replay-kit", library="replay-kit")
        summary = reader.get_summary()
        assert summary is not None
        topics = {channel.topic for channel in summary.channels.values()}
        wanted = [topic for topic in topics if _standard(vehicle.name, topic, estimate)]
        numbers: dict[int, int] = {}
        for schema, channel, message in reader.iter_messages(wanted or [""], log_time_order=False):
            if channel.id not in numbers:
                assert schema is not None
                kind = writer.register_schema(schema.name, schema.encoding, schema.data)
                topic = _standard(vehicle.name, channel.topic, estimate)
                numbers[channel.id] = _registered(writer, channel, topic, kind)
            writer.add_message(
                numbers[channel.id],
                message.log_time,
                message.data,
                message.publish_time,
                message.sequence,
            )
        own = _own_window(vehicle.name, reader)
        for found in reader.iter_attachments():
            if name := _attached(vehicle.name, own.get(found.name, found.name), estimate):
                writer.add_attachment(
                    found.create_time, found.log_time, name, found.media_type, found.data
                )
        for record in reader.iter_metadata():
            owner, _, name = record.name.rpartition("/")
            if record.name not in (DIGEST_NAME, VEHICLES_RECORD) and owner in ("", vehicle.name):
                writer.add_metadata(name, _of_vehicle(vehicle, name, record.metadata))
        writer.add_metadata(VEHICLE_RECORD, {"name": vehicle.name})
        writer.finish()  # type: ignore[no-untyped-call]


def _standard(vehicle: str, topic: str, estimate: bool) -> str:
    """Return the topic that a result of one vehicle has in place of one of a result of several; empty for those of no concern to it."""
    if topic.startswith(_SHARED) or topic in ("/tf", "/log"):
        return topic if estimate or topic in ("/tf", "/log") else ""
    prefix = f"/{vehicle}/"
    if not topic.startswith(prefix):
        return ""
    rest = topic.removeprefix(prefix)
    return _LONG.get(rest, f"/{rest}")


def _attached(vehicle: str, name: str, estimate: bool) -> str:
    """Return the name of an attachment in a result of one vehicle; empty for those of no concern to it."""
    owner, _, own = name.rpartition("/")
    if owner == vehicle:
        return own
    return name if name == CONFIG_NAME or (estimate and name.startswith("estimate")) else ""


def _own_window(vehicle: str, reader: McapReader) -> dict[str, str]:
    """Return the names that two estimates change, so that the last one of a vehicle's part is that of its window; none where it is."""
    records = (one.metadata for one in reader.iter_metadata() if one.name == WINDOWS_RECORD)
    number = json.loads(next(records, {}).get("vehicles", "{}")).get(vehicle)
    found = dict[str, str]()
    for name in (ESTIMATE_NAME, EARLIER_ESTIMATE) if number else ():
        own = f"{WINDOW_NAME}{number}.{name.rpartition('.')[2]}"
        found |= {own: name, name: own}
    return found


def _registered(writer: Writer, channel: Channel, topic: str, schema: int) -> int:
    return int(
        writer.register_channel(topic, channel.message_encoding, schema, dict(channel.metadata))
    )


def _of_vehicle(vehicle: VehicleRecord, name: str, values: Mapping[str, str]) -> dict[str, str]:
    """Return a record of the run as one of the vehicle's alone: its logs among the inputs, and its goal."""
    if name == _INPUTS:
        return {
            key: text
            for key, text in values.items()
            if not key.startswith("log") or key in vehicle.logs
        }
    return {**values, "goal": vehicle.goal} if name == _OPTIONS else dict(values)
