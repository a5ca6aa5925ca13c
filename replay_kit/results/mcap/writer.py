"""Result MCAP: all results of a run, in stock Foxglove messages if possible.

The file is written as ``OUT.mcap.part`` and renamed once it is complete and read back. Its times are those of events, never of writing, so
that equal runs give equal bytes.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any, Protocol

import foxglove

from replay_kit.core import __version__
from replay_kit.core.flow.compact import pack
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.grid import Projection, Seabed
from replay_kit.core.observation import Innovation, VehicleState
from replay_kit.core.plan import Plan
from replay_kit.core.surfacing import DiveOutcome, SurfacingOutcome
from replay_kit.results.innovations import TOPIC, block_of
from replay_kit.results.layout.layout import layout_of, layout_text
from replay_kit.results.mcap import messages
from replay_kit.results.mcap.file import Definition, ResultFile, Written
from replay_kit.results.mcap.schemas import CONTRACT_VERSION, DESCRIPTOR_SET
from replay_kit.results.mcap.topics import (
    CONFIG_NAME,
    ESTIMATE_NAME,
    LAYOUT_NAME,
    SUMMARY_NAME,
    WINDOW_NAME,
)
from replay_kit.results.outcome.outcome import Outcome
from replay_kit.results.slices import (
    Slice,
    arrow_scale,
    arrows_message,
    depth_slices,
    grid_message,
    seabed_message,
)
from replay_kit.results.vehicles import name_of, topic_of


class _Encodable(Protocol):
    def encode(self) -> bytes: ...
    @staticmethod
    def get_schema() -> foxglove.Schema: ...


class ResultWriter(ResultFile):
    """Writer of the values of a run to one result MCAP."""

    def __init__(
        self,
        path: Path,
        overwrite: bool = False,
        goes_on: bool = False,
    ) -> None:
        """Open ``path`` + ``.part``; an existing part is replaced.

        Args:
            path: Result file.
            overwrite: Whether an existing result is replaced.
            goes_on: See ``ResultFile``.

        Raises:
            ConfigError: The result exists and may not be replaced, or its folder is missing or not writable.
        """
        super().__init__(path, overwrite, goes_on)
        self._arrow_scale: float | None = None
        self._vehicle = ""

    @contextmanager
    def of(self, vehicle: str) -> Iterator[None]:
        """Write the values in the block under the topics and names of one of several vehicles; the estimate is common to all.

        Args:
            vehicle: Name of the vehicle; empty for a single one.
        """
        before, self._vehicle = self._vehicle, vehicle
        try:
            yield
        finally:
            self._vehicle = before

    def start(
        self,
        projection: Projection,
        time_ns: int,
        metadata: Mapping[str, Mapping[str, str]],
        config_toml: str,
    ) -> None:
        """Write frame, metadata records and configuration of the run.

        Args:
            projection: Local frame, called ``map`` in messages.
            time_ns: Time of the run's first event [ns, UTC].
            metadata: Record name to keys and values: input hashes, options, versions, basis identity.
            config_toml: Configuration, attached as ``config.toml``.
        """
        self._log("/tf", messages.frame_transform(time_ns), time_ns)
        self.write_metadata(
            "contract", {"version": str(CONTRACT_VERSION), "replay_kit": __version__}
        )
        frame = {
            "projection": "azimuthal equidistant, WGS84",
            "longitude": repr(float(projection.longitude)),
            "latitude": repr(float(projection.latitude)),
        }
        self.write_metadata("frame map", frame)
        for name, values in metadata.items():
            self.write_metadata(name, values)
        self.attach(time_ns, CONFIG_NAME, "application/toml", config_toml.encode())

    def fix(self, state: VehicleState) -> None:
        """Write a position to ``/vehicle/fix``."""
        frame = self._vehicle or messages.VEHICLE_FRAME
        self._log("/vehicle/fix", messages.location_fix(state, frame), state.time_ns)

    def vehicle(self, time_ns: int, place: Sequence[float], heading: float) -> None:
        """Write the vehicle's frame to ``/tf``; arguments as in ``messages.vehicle_transform``."""
        frame = self._vehicle or messages.VEHICLE_FRAME
        self._log("/tf", messages.vehicle_transform(time_ns, place, heading, frame), time_ns)

    def consistency(self, time_ns: int, findings: Sequence[Mapping[str, Any]]) -> None:
        """Write all findings so far, in the form of ``finding_json``, to ``/flow/consistency``."""
        self._log_own(
            "/flow/consistency", "Consistency", messages.consistency(time_ns, findings), time_ns
        )

    def innovations(self, block: Sequence[Innovation]) -> None:
        """Write the innovations of at least one observation to ``/flow/innovation``, at the time of the last one."""
        self._log_own(TOPIC, "Innovations", block_of(block), max(one.time_ns for one in block))

    def grids(self, time_ns: int, flow: FlowEstimate, depths: Sequence[float]) -> None:
        """Write depth slices to ``/flow/grid/{depth}m`` and ``/flow/arrows/{depth}m``, and the mean unknowns to ``/flow/estimate``.

        The first moving flow sets the scale of the arrows of the whole file.

        Args:
            time_ns: [ns, UTC].
            flow: The flow.
            depths: [m], positive down.
        """
        slices = depth_slices(flow, depths)
        self._arrow_scale = self._arrow_scale or arrow_scale(slices)
        for value in slices:
            self._log(f"/flow/grid/{value.depth:g}m", grid_message(time_ns, value), time_ns)
            self._log(
                f"/flow/arrows/{value.depth:g}m",
                arrows_message(time_ns, value, self._arrow_scale or 0.0),
                time_ns,
            )
        if flow.unknowns is not None:
            data = messages.unknowns(time_ns, flow)
            self._log_own("/flow/estimate", "Estimate", data, time_ns)
        self.flush()

    def surface(self, time_ns: int, value: Slice) -> None:
        """Write the surface current from radar and estimate at a time [ns, UTC] to ``/flow/surface``."""
        self._log("/flow/surface", grid_message(time_ns, value), time_ns)

    def plan(self, plan: Plan, projection: Projection) -> None:
        """Write a plan to ``/plan/path`` and ``/plan/controls``, and the last one at the end of the file to ``/plan/geojson``.

        Args:
            plan: The plan.
            projection: Local frame of its track.
        """
        time_ns = plan.start_time_ns
        self._log("/plan/path", messages.plan_path(plan), time_ns)
        self._log("/plan/geojson", messages.plan_geojson(plan, projection), time_ns, hold=True)
        self._log_own("/plan/controls", "Plan", messages.plan_controls(plan), time_ns)

    def seabed(self, time_ns: int, seabed: Seabed) -> None:
        """Write the seabed around the region to ``/plan/seabed``."""
        self._log("/plan/seabed", seabed_message(time_ns, seabed), time_ns)

    def record(self, name: str, values: Mapping[str, str]) -> None:
        """Write a metadata record of the run, or of the current vehicle."""
        self.write_metadata(name_of(self._vehicle, name), values)

    def outcome(self, outcome: SurfacingOutcome) -> None:
        """Write a predicted and the actual surfacing to ``/plan/outcome``."""
        self._log_own(
            "/plan/outcome", "PlanOutcome", messages.plan_outcome(outcome), outcome.time_ns
        )

    def dive_outcome(self, outcome: DiveOutcome) -> None:
        """Write the predicted and actual surfacing of a dive to ``/flow/surfacing``."""
        self._log_own(
            "/flow/surfacing", "Surfacing", messages.surfacing_message(outcome), outcome.fix.time_ns
        )

    def log(self, time_ns: int, level: messages.Level, text: str) -> None:
        """Write an event to ``/log``."""
        self._log("/log", messages.log_message(time_ns, level, text), time_ns)

    @property
    def state(self) -> tuple[Written, float | None]:
        """State for ``resume``: digest and arrow scale."""
        return self.written, self._arrow_scale

    def resume(self, source: Path, state: tuple[Written, float | None]) -> None:
        """Write the contents of a run up to a state; see ``restore``."""
        written, self._arrow_scale = state
        self.restore(source, written)

    def summary(self, time_ns: int, outcome: Outcome) -> None:
        """Attach the outcome of the run, and of each of several vehicles, as ``summary.json``.

        Args:
            time_ns: Time of the run's last message [ns, UTC].
            outcome: The outcome.
        """
        self.attach(time_ns, SUMMARY_NAME, "application/json", outcome.to_record())

    def window(self, number: int, flow: FlowEstimate) -> None:
        """Attach the last estimate of a window left by the vehicle, as ``estimate_window_1.npz`` and so on.

        Args:
            number: Number of the window, from 1.
            flow: Estimate.
        """
        self._attach_estimate(f"{WINDOW_NAME}{number}.npz", flow)

    def finish(self, flow: FlowEstimate) -> None:
        """Attach the last estimate with its covariance as ``estimate.npz``, and close the file.

        Raises:
            ReplayKitError: See ``close``.
        """
        time_ns = self.last_time_ns if flow.time_ns is None else flow.time_ns
        layout = layout_of(self.topics)
        self.attach(time_ns, LAYOUT_NAME, "application/json", layout_text(layout).encode())
        self._attach_estimate(ESTIMATE_NAME, flow)
        self.close()

    def _attach_estimate(self, name: str, flow: FlowEstimate) -> None:
        time_ns = self.last_time_ns if flow.time_ns is None else flow.time_ns
        self.attach(time_ns, name, "application/x-npz", pack(flow))

    def _log(self, topic: str, message: _Encodable, time_ns: int, hold: bool = False) -> None:
        write = self.hold_message if hold else self.write_message
        own = topic_of(self._vehicle, topic)
        write(own, _definition(type(message)), message.encode(), time_ns)

    def _log_own(self, topic: str, name: str, data: bytes, time_ns: int) -> None:
        own = topic_of(self._vehicle, topic)
        self.write_message(own, (f"replay_kit.{name}", "protobuf", DESCRIPTOR_SET), data, time_ns)


@cache
def _definition(kind: type[Any]) -> Definition:
    schema = kind.get_schema()
    return schema.name, schema.encoding, schema.data
