"""The result MCAP: everything a run found, in stock Foxglove messages where one exists.

The file is written as ``OUT.mcap.part`` and gets its name only when it is whole on the disk and was read back. Times in it
are those of the events, never of the writing, so that the same run gives the same bytes.
"""

import hashlib
import os
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol

import foxglove
from mcap.writer import CompressionType, Writer

from replay_kit import __version__
from replay_kit.errors import ConfigError, ReplayKitError
from replay_kit.flow import FlowEstimate
from replay_kit.flow_netcdf import save_bytes
from replay_kit.logs.atomic import sync
from replay_kit.logs.raw import RawChannel, RawMessage
from replay_kit.logs.raw_channels import OutChannels
from replay_kit.results import messages
from replay_kit.results.digest import DIGEST_NAME, Digest
from replay_kit.results.journal import Journal
from replay_kit.results.readback import check_written
from replay_kit.results.schemas import CONTRACT_VERSION, DESCRIPTOR_SET
from replay_kit.results.slices import arrow_scale, arrows_message, depth_slice, grid_message
from replay_kit.types import Array, Innovation, Plan, Projection, VehicleState

ESTIMATE_NAME = "estimate.nc"
CONFIG_NAME = "config.toml"

#: The input number of the channels that are ours.
_OURS = -1
#: Topics that are the result's own: an input's messages on such a topic go below ``/input``.
_OWN_TOPICS = ("/tf", "/vehicle/fix", "/flow/", "/plan/", "/log")
_OWN_SCHEMA = ("protobuf", DESCRIPTOR_SET)


class _Encodable(Protocol):
    def encode(self) -> bytes: ...
    @staticmethod
    def get_schema() -> foxglove.Schema: ...


class ResultWriter:
    """Writes one result MCAP; a context manager that publishes the file when its block ends well.

    After an exception or an interrupt the file stays as ``OUT.mcap.part``, closed and readable up to there.
    """

    def __init__(
        self, path: Path, overwrite: bool = False, on_digest: Callable[[Digest], None] | None = None, journal: Journal | None = None
    ) -> None:
        """Open ``path`` + ``.part``; one left over by an interrupted run is replaced.

        Args:
            path: The result file.
            overwrite: Replace an existing result.
            on_digest: Called with each digest written.
            journal: Is told everything that the file is.

        Raises:
            ConfigError: The result exists and may not be replaced, or its folder does not exist or cannot be written.
        """
        self.path = Path(path)
        self.part = self.path.with_name(self.path.name + ".part")
        self._overwrite = overwrite
        self._check_target()
        try:
            self._file = open(self.part, "wb")  # noqa: SIM115 - closed by close, abandon or discard
        except OSError as error:
            raise ConfigError(f"{self.path}: cannot write there: {error.strerror}; choose another place") from error
        self._writer = Writer(self._file, compression=CompressionType.ZSTD, enable_crcs=True, enable_data_crcs=True)
        # without the library's version, which says nothing about the content
        self._writer.start(profile="replay-kit", library="replay-kit")
        self._out = OutChannels(self._writer)
        self._channels: dict[str, int] = {}
        self._counts: Counter[str] = Counter()
        self._attachments = 0
        self._accepted = 0
        self._last_time_ns = 0
        self._arrow_scale: float | None = None
        self._digest = hashlib.sha256()
        self._on_digest = on_digest
        self._journal = journal
        self._open = True

    def __enter__(self) -> "ResultWriter":
        """Return the writer."""
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        """Publish the file, or leave it as ``.part`` when the block raised."""
        if kind is None:
            self.close()
        else:
            self.abandon()

    def start(self, projection: Projection, time_ns: int, metadata: Mapping[str, Mapping[str, str]], config_toml: str) -> None:
        """Write what holds for the whole run: the frame, the metadata records and the configuration.

        Args:
            projection: The local frame, which the messages call ``map``.
            time_ns: Time of the run's first event [ns, UTC].
            metadata: Record name to keys and values: input hashes, options, versions, basis identity.
            config_toml: The configuration, attached as ``config.toml``.
        """
        self._log("/tf", messages.frame_transform(time_ns), time_ns)
        self._metadata("contract", {"version": str(CONTRACT_VERSION), "replay_kit": __version__})
        frame = {
            "projection": "azimuthal equidistant, WGS84",
            "longitude": repr(float(projection.longitude)),
            "latitude": repr(float(projection.latitude)),
        }
        self._metadata("frame map", frame)
        for name, values in metadata.items():
            self._metadata(name, values)
        self._attach(time_ns, CONFIG_NAME, "application/toml", config_toml.encode())

    def fix(self, state: VehicleState) -> None:
        """Write a position to ``/vehicle/fix``."""
        self._log("/vehicle/fix", messages.location_fix(state), state.time_ns)

    def innovation(self, value: Innovation) -> None:
        """Write what an observation said against the prediction to ``/flow/innovation``."""
        self._log_own("/flow/innovation", "Innovation", messages.innovation(value), value.time_ns)
        self._accepted += bool(value.accepted)

    def estimate(self, time_ns: int, weights: Array, levels: Array) -> None:
        """Write the current weights to ``/flow/estimate``, with the number of accepted innovations written before.

        Args:
            time_ns: [ns, UTC].
            weights: shape (rZ,), of r modes a level, level after level.
            levels: shape (Z,) [m], positive down.
        """
        data = messages.flow_estimate(time_ns, weights, levels, self._accepted)
        self._log_own("/flow/estimate", "FlowEstimate", data, time_ns)

    def grids(self, time_ns: int, flow: FlowEstimate, depths: Sequence[float]) -> None:
        """Write depth slices to ``/flow/grid/{depth}m`` and ``/flow/arrows/{depth}m``.

        The first flow that moves sets the length of arrows for the whole file, so that later ones compare.

        Args:
            time_ns: [ns, UTC].
            flow: The flow.
            depths: [m], positive down.
        """
        slices = [depth_slice(flow, depth) for depth in depths]
        self._arrow_scale = self._arrow_scale or arrow_scale(slices)
        for value in slices:
            self._log(f"/flow/grid/{value.depth:g}m", grid_message(time_ns, value), time_ns)
            self._log(f"/flow/arrows/{value.depth:g}m", arrows_message(time_ns, value, self._arrow_scale or 0.0), time_ns)
        self.checkpoint()

    def plan(self, plan: Plan, projection: Projection) -> None:
        """Write a plan to ``/plan/path``, ``/plan/geojson`` and ``/plan/controls``.

        Args:
            plan: The plan.
            projection: The local frame of its track.
        """
        time_ns = plan.start_time_ns
        self._log("/plan/path", messages.plan_path(plan), time_ns)
        self._log("/plan/geojson", messages.plan_geojson(plan, projection), time_ns)
        self._log_own("/plan/controls", "Plan", messages.plan_controls(plan), time_ns)

    def log(self, time_ns: int, level: messages.Level, text: str) -> None:
        """Write an event to ``/log``."""
        self._log("/log", messages.log_message(time_ns, level, text), time_ns)

    def digest(self, time_ns: int) -> None:
        """Write what the messages so far amount to as a metadata record, so that a repeated run can be compared on its way."""
        value = Digest(time_ns, self._counts.total(), self._digest.hexdigest())
        self._metadata(DIGEST_NAME, {"time_ns": str(time_ns), "messages": str(value.messages), "sha256": value.sha256})
        if self._on_digest is not None:
            self._on_digest(value)

    @property
    def memory(self) -> tuple[int, float | None]:
        """What the writer knows beside the file: accepted innovations, and the length of arrows."""
        return self._accepted, self._arrow_scale

    def write_again(
        self, entries: Iterable[tuple[dict[str, Any], bytes]], memory: tuple[int, float | None], copy_again: Callable[[], None]
    ) -> None:
        """Write what an interrupted run had written.

        Args:
            entries: Of its journal; they are not told to this writer's.
            memory: Its ``memory``.
            copy_again: Copies the inputs, which no journal repeats.
        """
        journal, self._journal = self._journal, None
        schemas: dict[str, tuple[str, str, bytes]] = {}
        for head, data in entries:
            if head["kind"] == "schema":
                schemas[head["topic"]] = (head["name"], head["encoding"], data)
            elif head["kind"] == "message":
                self._write(head["topic"], partial(schemas.__getitem__, head["topic"]), data, head["time_ns"])
            elif head["kind"] == "attachment":
                self._attach(head["time_ns"], head["name"], head["media_type"], data)
            elif head["kind"] == "copies":
                copy_again()
            elif head["kind"] == "checkpoint":
                self.checkpoint()
            else:
                self._metadata(head["name"], head["values"])
        self._accepted, self._arrow_scale = memory
        self._journal = journal

    def copy(self, source: Iterator[RawMessage]) -> None:
        """Write an input's messages as they are; those on a topic of the result's own go to ``/input`` and their topic.

        Args:
            source: The messages of all logs.
        """
        self._tell({"kind": "copies"}, b"")
        renamed: dict[RawChannel, RawChannel] = {}
        with self._storing("copy the inputs"):
            for message in source:
                channel = renamed.get(message.channel) or renamed.setdefault(message.channel, _beside_ours(message.channel))
                number = self._out.number(message.input, channel)
                self._writer.add_message(number, message.log_ns, message.data, message.publish_ns, message.sequence)
                self._counts[channel.topic] += 1

    def checkpoint(self) -> None:
        """Put everything written so far on the disk as whole chunks, from which ``convert`` has it back after a power cut."""
        with self._storing("write"):
            self._writer.flush()  # type: ignore[no-untyped-call]
            os.fsync(self._file.fileno())
        self._tell({"kind": "checkpoint"}, b"")

    def finish(self, flow: FlowEstimate) -> None:
        """Attach the last estimate without loss, with its covariance, as ``estimate.nc``; then close.

        Raises:
            ReplayKitError: As for ``close``.
        """
        time_ns = self._last_time_ns if flow.time_ns is None else flow.time_ns
        self._attach(time_ns, ESTIMATE_NAME, "application/netcdf", save_bytes(flow))
        self.close()

    def close(self) -> None:
        """Complete the file, read it back and give it its name; a second call does nothing.

        Raises:
            ReplayKitError: The file could not be written whole; it stays as ``.part``.
            ConfigError: A result appeared under the name meanwhile and may not be replaced; ours stays as ``.part``.
        """
        if not self._open:
            return
        self._end()
        check_written(self.part, self._counts, self._attachments)
        self._check_target()
        os.replace(self.part, self.path)
        sync(self.path.parent)

    def abandon(self) -> None:
        """Stop: what was written so far stays as ``.part``; on a closed result this does nothing."""
        # The caller is already handling the error that stopped the run; a second one would hide it.
        with suppress(ReplayKitError):
            if self._open:
                self._end()

    def discard(self) -> None:
        """Stop and leave nothing; on a closed result this does nothing."""
        if self._open:
            self.abandon()
            self.part.unlink(missing_ok=True)

    def _end(self) -> None:
        self._open = False
        try:
            with self._storing("complete the result"):
                self._writer.finish()  # type: ignore[no-untyped-call]
                self._file.flush()
                os.fsync(self._file.fileno())
        finally:
            # what a full disk did not take is tried again by the file's closing
            with suppress(OSError):
                self._file.close()

    def _log(self, topic: str, message: _Encodable, time_ns: int) -> None:
        self._write(topic, lambda: _definition(message.get_schema()), message.encode(), time_ns)

    def _log_own(self, topic: str, name: str, data: bytes, time_ns: int) -> None:
        self._write(topic, lambda: (f"replay_kit.{name}", *_OWN_SCHEMA), data, time_ns)

    def _write(self, topic: str, schema: Callable[[], tuple[str, str, bytes]], data: bytes, time_ns: int) -> None:
        assert self._open, "a closed result takes no messages"
        with self._storing("write"):
            number = self._channels.get(topic)
            if number is None:
                name, encoding, definition = schema()
                number = self._channels[topic] = self._out.number(_OURS, RawChannel(0, topic, "protobuf", (), (name, encoding, definition)))
                self._tell({"kind": "schema", "topic": topic, "name": name, "encoding": encoding}, definition)
            self._writer.add_message(number, time_ns, data, time_ns, self._counts[topic])
        self._tell({"kind": "message", "topic": topic, "time_ns": time_ns}, data)
        self._digest.update(f"{topic}\0{time_ns}\0{len(data)}\0".encode() + data)
        self._counts[topic] += 1
        self._last_time_ns = max(self._last_time_ns, time_ns)

    def _attach(self, time_ns: int, name: str, media_type: str, data: bytes) -> None:
        with self._storing(f"attach {name}"):
            self._writer.add_attachment(create_time=time_ns, log_time=time_ns, name=name, media_type=media_type, data=data)
        self._tell({"kind": "attachment", "time_ns": time_ns, "name": name, "media_type": media_type}, data)
        self._attachments += 1

    def _metadata(self, name: str, values: Mapping[str, str]) -> None:
        with self._storing(f"write the metadata {name}"):
            self._writer.add_metadata(name, dict(values))
        self._tell({"kind": "metadata", "name": name, "values": dict(values)}, b"")

    def _tell(self, head: dict[str, Any], data: bytes) -> None:
        if self._journal is not None:
            self._journal.append(head, data)

    @contextmanager
    def _storing(self, what: str) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise ReplayKitError(f"{self.part}: cannot {what}: {error}; is the disk full?") from error

    def _check_target(self) -> None:
        if not self.path.parent.is_dir():
            raise ConfigError(f"{self.path}: the folder {self.path.parent} does not exist; make it or write elsewhere")
        if self.path.is_dir():
            raise ConfigError(f"{self.path}: a folder, but the result is a file; give it a name")
        if self.path.exists() and not self._overwrite:
            raise ConfigError(f"{self.path}: exists already; pass --overwrite to replace it, or write elsewhere")


def _beside_ours(channel: RawChannel) -> RawChannel:
    """Return an input's channel under a name that is none of the result's."""
    if not channel.topic.startswith(_OWN_TOPICS):
        return channel
    return replace(channel, topic=f"/input{channel.topic}")


def _definition(schema: foxglove.Schema) -> tuple[str, str, bytes]:
    return schema.name, schema.encoding, schema.data
