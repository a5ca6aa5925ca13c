"""The result MCAP: everything a run found, in stock Foxglove messages where one exists.

The file is written as ``OUT.mcap.part`` and gets its name only when it is whole on the disk and was read back. Times in it
are those of the events, never of the writing, so that the same run gives the same bytes.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol

import foxglove

from replay_kit import __version__
from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.flow.lossless import save_bytes
from replay_kit.core.grid import Projection
from replay_kit.core.observation import Innovation, VehicleState
from replay_kit.core.plan import Plan
from replay_kit.core.surfacing import Outcome
from replay_kit.logs.raw import RawMessage
from replay_kit.results import messages
from replay_kit.results.digest import DIGEST_NAME, Digest
from replay_kit.results.journal import Journal
from replay_kit.results.mcap_file import ResultFile
from replay_kit.results.schemas import CONTRACT_VERSION, DESCRIPTOR_SET
from replay_kit.results.slices import arrow_scale, arrows_message, depth_slice, grid_message

ESTIMATE_NAME = "estimate.nc"
CONFIG_NAME = "config.toml"

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
        self._file = ResultFile(path, overwrite, journal)
        self._accepted = 0
        self._arrow_scale: float | None = None
        self._on_digest = on_digest

    @property
    def path(self) -> Path:
        """The result file."""
        return self._file.path

    @property
    def part(self) -> Path:
        """The file's name until it is whole."""
        return self._file.part

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
        self._file.metadata("contract", {"version": str(CONTRACT_VERSION), "replay_kit": __version__})
        frame = {
            "projection": "azimuthal equidistant, WGS84",
            "longitude": repr(float(projection.longitude)),
            "latitude": repr(float(projection.latitude)),
        }
        self._file.metadata("frame map", frame)
        for name, values in metadata.items():
            self._file.metadata(name, values)
        self._file.attach(time_ns, CONFIG_NAME, "application/toml", config_toml.encode())

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
        self._file.checkpoint()

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

    def outcome(self, outcome: Outcome) -> None:
        """Write a plan's next surfacing beside the vehicle's to ``/plan/outcome``."""
        self._log_own("/plan/outcome", "PlanOutcome", messages.plan_outcome(outcome), outcome.time_ns)

    def log(self, time_ns: int, level: messages.Level, text: str) -> None:
        """Write an event to ``/log``."""
        self._log("/log", messages.log_message(time_ns, level, text), time_ns)

    def digest(self, time_ns: int) -> None:
        """Write what the messages so far amount to as a metadata record, so that a repeated run can be compared on its way."""
        value = self._file.digest(time_ns)
        self._file.metadata(DIGEST_NAME, {"time_ns": str(time_ns), "messages": str(value.messages), "sha256": value.sha256})
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
        self._file.write_again(entries, copy_again)
        self._accepted, self._arrow_scale = memory

    def copy(self, source: Iterator[RawMessage]) -> None:
        """Write an input's messages as they are; those on a topic of the result's own go to ``/input`` and their topic.

        Args:
            source: The messages of all logs.
        """
        self._file.copy(source)

    def finish(self, flow: FlowEstimate) -> None:
        """Attach the last estimate without loss, with its covariance, as ``estimate.nc``; then close.

        Raises:
            ReplayKitError: As for ``close``.
        """
        time_ns = self._file.last_time_ns if flow.time_ns is None else flow.time_ns
        self._file.attach(time_ns, ESTIMATE_NAME, "application/netcdf", save_bytes(flow))
        self.close()

    def close(self) -> None:
        """Complete the file, read it back and give it its name; a second call does nothing.

        Raises:
            ReplayKitError: The file could not be written whole; it stays as ``.part``.
            ConfigError: A result appeared under the name meanwhile and may not be replaced; ours stays as ``.part``.
        """
        self._file.close()

    def abandon(self) -> None:
        """Stop: what was written so far stays as ``.part``; on a closed result this does nothing."""
        self._file.abandon()

    def discard(self) -> None:
        """Stop and leave nothing; on a closed result this does nothing."""
        self._file.discard()

    def _log(self, topic: str, message: _Encodable, time_ns: int) -> None:
        self._file.write(topic, lambda: _definition(message.get_schema()), message.encode(), time_ns)

    def _log_own(self, topic: str, name: str, data: bytes, time_ns: int) -> None:
        self._file.write(topic, lambda: (f"replay_kit.{name}", *_OWN_SCHEMA), data, time_ns)


def _definition(schema: foxglove.Schema) -> tuple[str, str, bytes]:
    return schema.name, schema.encoding, schema.data
