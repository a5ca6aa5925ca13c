"""Result MCAP: all results of a run, in stock Foxglove messages if possible.

The file is written as ``OUT.mcap.part`` and renamed once it is complete and read back. Its times are those of events, never of writing, so
that equal runs give equal bytes.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from functools import cache
from operator import attrgetter
from pathlib import Path
from typing import Any, Literal

import foxglove.messages as fox

from replay_kit.core import __version__
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.flow.file import pack
from replay_kit.core.geodesy import unwrap_longitude
from replay_kit.core.grid import Projection, Seabed
from replay_kit.core.observation import Innovation, VehicleState
from replay_kit.core.plan import Place, Plan, leg_statistics
from replay_kit.core.region import collection_text
from replay_kit.core.surfacing import DiveOutcome, Ellipse, SurfacingOutcome
from replay_kit.results.geojson import plan_features
from replay_kit.results.innovations import TOPIC, block_of
from replay_kit.results.layout import layout_of, layout_text
from replay_kit.results.mcap.file import Definition, ResultFile, Written
from replay_kit.results.mcap.schemas import (
    CONTRACT_VERSION,
    DESCRIPTOR_SET,
    MESSAGES,
    TIME,
    attributes,
    encode,
)
from replay_kit.results.mcap.topics import (
    CONFIG_NAME,
    ESTIMATE_NAME,
    LAYOUT_NAME,
    SUMMARY_NAME,
    WINDOW_NAME,
    name_of,
    topic_of,
)
from replay_kit.results.outcome.outcome import Outcome
from replay_kit.results.slices import (
    FRAME,
    Slices,
    arrow_scale,
    arrows_message,
    basis_of,
    depth_slices,
    grid_message,
    orientation,
    pose,
    seabed_message,
    stamp,
)

ROOT_FRAME = "earth"
VEHICLE_FRAME = "vehicle"
# a finding's key in JSON, whose field has another name
_FINDING = {"set": "advice"}


class ResultWriter(ResultFile):
    """Writer of the values of a run to one result MCAP.

    Its arguments are those of ``ResultFile``.
    """

    _arrow_scale: float | None = None
    _vehicle = ""

    @contextmanager
    def for_vehicle(self, vehicle: str) -> Iterator[None]:
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
        self._transform(time_ns, ROOT_FRAME, FRAME, fox.Vector3(), fox.Quaternion(w=1.0))
        frame = {
            "projection": "azimuthal equidistant, WGS84",
            "longitude": repr(float(projection.longitude)),
            "latitude": repr(float(projection.latitude)),
        }
        contract = {"version": str(CONTRACT_VERSION), "replay_kit": __version__}
        for name, values in {"contract": contract, "frame map": frame, **metadata}.items():
            self.write_metadata(name, values)
        self.attach(time_ns, CONFIG_NAME, "application/toml", config_toml.encode())

    def fix(self, state: VehicleState) -> None:
        """Write a position to ``/vehicle/fix``, longitude in [-180, 180].

        ``metadata`` holds ``depth`` [m], if known, for reading the fix back. For viewers the altitude is -depth, NaN if unknown; other
        writers state a height above the ellipsoid.
        """
        longitude, about = state.longitude, {"dead_reckoned": str(int(state.dead_reckoned))}
        if not -180.0 <= longitude <= 180.0:
            longitude = float(unwrap_longitude(longitude, 0.0))
        if math.isfinite(state.depth):
            about["depth"] = repr(float(state.depth))
        message = fox.LocationFix(
            timestamp=stamp(state.time_ns),
            frame_id=self._vehicle or VEHICLE_FRAME,
            latitude=state.latitude,
            longitude=longitude,
            altitude=-state.depth,
            metadata=[fox.KeyValuePair(key=key, value=value) for key, value in about.items()],
        )
        self._log("/vehicle/fix", message, state.time_ns)

    def vehicle(self, time_ns: int, place: Sequence[float], heading: float) -> None:
        """Write the vehicle's frame in ``map`` to ``/tf``.

        Args:
            time_ns: [ns, UTC].
            place: Local east, local north and depth [m].
            heading: Course, clockwise from local north [rad].
        """
        east, north, depth = place
        at, turn = fox.Vector3(x=east, y=north, z=-depth), (math.sin(heading), math.cos(heading))
        frame = self._vehicle or VEHICLE_FRAME
        self._transform(time_ns, FRAME, frame, at, orientation(*turn, 0.0))

    def _transform(
        self, time_ns: int, parent: str, child: str, at: fox.Vector3, turn: fox.Quaternion
    ) -> None:
        message = fox.FrameTransform(
            timestamp=stamp(time_ns),
            parent_frame_id=parent,
            child_frame_id=child,
            translation=at,
            rotation=turn,
        )
        self._log("/tf", message, time_ns)

    def consistency(self, time_ns: int, findings: Sequence[Mapping[str, Any]]) -> None:
        """Write all findings so far, in the form of ``finding_json``, to ``/flow/consistency``."""
        found = [
            {_FINDING.get(key, key): value or "" for key, value in one.items()} for one in findings
        ]
        values = {"timestamp": time_ns, "findings": found}
        self._log_own("/flow/consistency", "Consistency", None, time_ns, values)

    def innovations(self, block: Sequence[Innovation]) -> None:
        """Write the innovations of at least one observation to ``/flow/innovation``, at the time of the last one."""
        self._write_own(TOPIC, "Innovations", block_of(block), max(one.time_ns for one in block))

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
        for level, depth in enumerate(depths):
            arrows = arrows_message(time_ns, slices, level, self._arrow_scale or 0.0)
            self._log(f"/flow/grid/{depth:g}m", grid_message(time_ns, slices, level), time_ns)
            self._log(f"/flow/arrows/{depth:g}m", arrows, time_ns)
        if flow.unknowns is not None:
            values = {"timestamp": time_ns, "basis": basis_of(flow), "x": flow.unknowns.x}
            self._log_own("/flow/estimate", "Estimate", None, time_ns, values)
        self.flush()

    def surface(self, time_ns: int, value: Slices) -> None:
        """Write the surface current from radar and estimate at a time [ns, UTC] to ``/flow/surface``."""
        self._log("/flow/surface", grid_message(time_ns, value), time_ns)

    def plan(self, plan: Plan, projection: Projection) -> None:
        """Write a plan to ``/plan/path`` and ``/plan/controls``, and the last one at the end of the file to ``/plan/geojson``.

        Args:
            plan: The plan.
            projection: Local frame of its track.
        """
        time_ns = plan.start_time_ns
        east, north, down = plan.velocity_through_water.tolist()
        along, track = orientation(east, north, -down), plan.track.tolist()
        poses = [pose(x, y, -depth, along) for x, y, depth in track]
        path = fox.PosesInFrame(timestamp=stamp(time_ns), frame_id=FRAME, poses=poses)
        self._log("/plan/path", path, time_ns)
        drawn = fox.GeoJson(geojson=collection_text([*plan_features(plan, projection)]))
        self.hold_message(*self._encoded("/plan/geojson", drawn), time_ns)
        statistics = sorted({**plan.statistics, **leg_statistics(plan.legs)}.items())
        values = dict(zip(("track_east", "track_north", "track_depth"), plan.track.T, strict=True))
        values |= {
            "statistics": [{"name": name, "value": str(value)} for name, value in statistics],
            "track_bottom": () if plan.bottom is None else plan.bottom,
            "odds": None if plan.odds is None else asdict(plan.odds),
            "via": [*map(_place, plan.via)],
        }
        self._log_own("/plan/controls", "Plan", plan, time_ns, values)

    def seabed(self, time_ns: int, seabed: Seabed) -> None:
        """Write the seabed around the region to ``/plan/seabed``."""
        self._log("/plan/seabed", seabed_message(time_ns, seabed), time_ns)

    def record(self, name: str, values: Mapping[str, str]) -> None:
        """Write a metadata record of the run, or of the current vehicle."""
        self.write_metadata(name_of(self._vehicle, name), values)

    def outcome(self, outcome: SurfacingOutcome) -> None:
        """Write a predicted and the actual surfacing to ``/plan/outcome``; a missing ellipse is NaN."""
        ellipse = asdict(outcome.predicted.ellipse or Ellipse(*[math.nan] * 5))
        values = {f"ellipse_{name.removesuffix('_deg')}": value for name, value in ellipse.items()}
        values |= {"actual": outcome, "inside_ellipse": bool(outcome.inside)}
        self._log_own("/plan/outcome", "PlanOutcome", outcome, outcome.time_ns, values)

    def dive_outcome(self, outcome: DiveOutcome) -> None:
        """Write the predicted and actual surfacing of a dive to ``/flow/surfacing``; figures of persistence are NaN before a spread."""
        self._log_own("/flow/surfacing", "Surfacing", outcome, outcome.fix.time_ns, {})

    def log(
        self, time_ns: int, level: Literal["debug", "info", "warning", "error"], text: str
    ) -> None:
        """Write an event to ``/log``."""
        size = getattr(fox.LogLevel, level.title())
        message = fox.Log(timestamp=stamp(time_ns), level=size, message=text, name="replay-kit")
        self._log("/log", message, time_ns)

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
        layout = layout_text(layout_of(self.topics)).encode()
        self.attach(self._time(flow), LAYOUT_NAME, "application/json", layout)
        self._attach_estimate(ESTIMATE_NAME, flow)
        self.close()

    def _time(self, flow: FlowEstimate) -> int:
        return self.last_time_ns if flow.time_ns is None else flow.time_ns

    def _attach_estimate(self, name: str, flow: FlowEstimate) -> None:
        self.attach(self._time(flow), name, "application/x-npz", pack(flow))

    def _encoded(self, topic: str, message: Any) -> tuple[str, Definition, bytes]:
        return topic_of(self._vehicle, topic), _definition(message.__class__), message.encode()

    def _log(self, topic: str, message: Any, time_ns: int) -> None:
        self.write_message(*self._encoded(topic, message), time_ns)

    def _log_own(
        self, topic: str, name: str, value: Any, time_ns: int, more: Mapping[str, Any]
    ) -> None:
        """Write a message of our table from the attributes of a value and further fields; positions and times are converted."""
        kinds, held = {TIME: _stamp, ".replay_kit.Place": _place}, dict[str, Any]()
        for field in MESSAGES[name]:
            content = more[field.name] if field.name in more else attrgetter(field.path)(value)
            made = field.type in kinds and not field.repeated
            held[field.name] = kinds[field.type](content) if made else content
        self._write_own(topic, name, encode(name, held), time_ns)

    def _write_own(self, topic: str, name: str, data: bytes, time_ns: int) -> None:
        definition = f"replay_kit.{name}", "protobuf", DESCRIPTOR_SET
        self.write_message(topic_of(self._vehicle, topic), definition, data, time_ns)


@cache
def _definition(kind: type[Any]) -> Definition:
    schema = kind.get_schema()
    return schema.name, schema.encoding, schema.data


def _stamp(time_ns: int) -> dict[str, int]:
    time = stamp(time_ns)
    return {"seconds": time.sec, "nanos": time.nsec}


def _place(place: Any) -> dict[str, float]:
    """Return ``replay_kit.Place``, at depth 0 for a surfacing."""
    depth = place.depth if isinstance(place, Place) else 0.0
    return attributes(place, "longitude latitude") | {"depth": depth}
