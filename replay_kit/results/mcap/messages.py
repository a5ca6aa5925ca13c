"""Messages of the result file from values: pure functions, one per topic.

Poses are in the frame ``map``: local east, local north, up, so z = -depth.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from functools import lru_cache
from operator import attrgetter
from typing import Any, Literal
from zlib import crc32

import foxglove.messages as fox

from replay_kit.core.errors import ReplayKitError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.geodesy import unwrap_longitude
from replay_kit.core.grid import Projection
from replay_kit.core.observation import VehicleState
from replay_kit.core.plan import Place, Plan, leg_statistics
from replay_kit.core.region import collection_text
from replay_kit.core.surfacing import DiveOutcome, Ellipse, SurfacingOutcome
from replay_kit.results.mcap.schemas import MESSAGES, TIME, attributes, encode
from replay_kit.results.plans import plan_features

Level = Literal["debug", "info", "warning", "error"]

FRAME = "map"
ROOT_FRAME = "earth"
VEHICLE_FRAME = "vehicle"

_LEVELS = {
    "debug": fox.LogLevel.Debug,
    "info": fox.LogLevel.Info,
    "warning": fox.LogLevel.Warning,
    "error": fox.LogLevel.Error,
}
_SECOND = 1_000_000_000
# a finding's key in JSON, whose field has another name
_FINDING = {"set": "advice"}


def stamp(time_ns: int) -> fox.Timestamp:
    """Return a Foxglove timestamp.

    Raises:
        ReplayKitError: The time lies outside 1970..2106, the range of the message.
    """
    try:
        return fox.Timestamp(*divmod(time_ns, _SECOND))
    except OverflowError as error:
        raise ReplayKitError(
            f"time {time_ns} ns cannot be written: result files hold times from 1970 to 2106; check the log's clock"
        ) from error


def frame_transform(time_ns: int) -> fox.FrameTransform:
    """Return the identity transform that declares the frame ``map`` at the root."""
    return fox.FrameTransform(
        timestamp=stamp(time_ns),
        parent_frame_id=ROOT_FRAME,
        child_frame_id=FRAME,
        translation=fox.Vector3(),
        rotation=fox.Quaternion(w=1.0),
    )


def vehicle_transform(
    time_ns: int, place: Sequence[float], heading: float, frame: str = VEHICLE_FRAME
) -> fox.FrameTransform:
    """Return the transform of a vehicle's frame in ``map``.

    Args:
        time_ns: [ns, UTC].
        place: Local east, local north and depth [m].
        heading: Course, clockwise from local north [rad].
        frame: Frame of the vehicle.
    """
    east, north, depth = place
    return fox.FrameTransform(
        timestamp=stamp(time_ns),
        parent_frame_id=FRAME,
        child_frame_id=frame,
        translation=fox.Vector3(x=east, y=north, z=-depth),
        rotation=orientation(math.sin(heading), math.cos(heading), 0.0),
    )


def consistency(time_ns: int, findings: Sequence[Mapping[str, Any]]) -> bytes:
    """Return ``replay_kit.Consistency``: all findings so far, in the form of ``finding_json``."""
    found = [
        {_FINDING.get(key, key): value or "" for key, value in one.items()} for one in findings
    ]
    return encode("Consistency", {"timestamp": _time(time_ns), "findings": found})


def location_fix(state: VehicleState, frame: str = VEHICLE_FRAME) -> fox.LocationFix:
    """Return the vehicle's position, longitude in [-180, 180].

    ``metadata`` holds ``depth`` [m], if known, for reading the fix back. For viewers the altitude is -depth, NaN if unknown; other writers
    state a height above the ellipsoid.
    """
    longitude = (
        state.longitude
        if -180.0 <= state.longitude <= 180.0
        else float(unwrap_longitude(state.longitude, 0.0))
    )
    metadata = [fox.KeyValuePair(key="dead_reckoned", value=str(int(state.dead_reckoned)))]
    if math.isfinite(state.depth):
        metadata.append(fox.KeyValuePair(key="depth", value=repr(float(state.depth))))
    return fox.LocationFix(
        timestamp=stamp(state.time_ns),
        frame_id=frame,
        latitude=state.latitude,
        longitude=longitude,
        altitude=-state.depth,
        metadata=metadata,
    )


def log_message(time_ns: int, level: Level, text: str) -> fox.Log:
    """Return an event for ``/log``."""
    return fox.Log(timestamp=stamp(time_ns), level=_LEVELS[level], message=text, name="replay-kit")


def basis_of(flow: FlowEstimate) -> int:
    """Return a number that identifies the modes of an estimate's window."""
    return crc32(flow.modes.astype("<f4").tobytes())


def unknowns(time_ns: int, flow: FlowEstimate) -> bytes:
    """Return ``replay_kit.Estimate``: the mean of the unknowns of an estimate with unknowns."""
    assert flow.unknowns is not None
    values = {"timestamp": _time(time_ns), "basis": basis_of(flow), "x": flow.unknowns.x}
    return encode("Estimate", values)


def plan_controls(plan: Plan) -> bytes:
    """Return ``replay_kit.Plan``."""
    east, north, depth = plan.track.T
    statistics = sorted({**plan.statistics, **leg_statistics(plan.legs)}.items())
    return _table_message(
        "Plan",
        plan,
        track_east=east,
        track_north=north,
        track_depth=depth,
        statistics=[{"name": name, "value": str(value)} for name, value in statistics],
        track_bottom=() if plan.bottom is None else plan.bottom,
        odds=None if plan.odds is None else asdict(plan.odds),
    )


def plan_outcome(outcome: SurfacingOutcome) -> bytes:
    """Return ``replay_kit.PlanOutcome``; a missing ellipse is NaN."""
    ellipse = outcome.predicted.ellipse or Ellipse(*[math.nan] * 5)
    return _table_message(
        "PlanOutcome",
        outcome,
        actual=outcome,
        inside_ellipse=bool(outcome.inside),
        **{
            f"ellipse_{name.removesuffix('_deg')}": value for name, value in asdict(ellipse).items()
        },
    )


def surfacing_message(outcome: DiveOutcome) -> bytes:
    """Return ``replay_kit.Surfacing``; figures of persistence are NaN before it has a spread."""
    return _table_message("Surfacing", outcome)


def _table_message(name: str, value: Any, **more: Any) -> bytes:
    """Return a message of the table from the attributes of a value and further fields; positions and times are converted."""
    kinds, held = {TIME: _time, ".replay_kit.Place": _place}, dict[str, Any]()
    for field in MESSAGES[name]:
        of = more[field.name] if field.name in more else attrgetter(field.path)(value)
        held[field.name] = kinds[field.type](of) if field.type in kinds else of
    return encode(name, held)


def _place(place: Any) -> dict[str, float]:
    """Return ``replay_kit.Place``, at depth 0 for a surfacing."""
    depth = place.depth if isinstance(place, Place) else 0.0
    return attributes(place, "longitude latitude") | {"depth": depth}


def plan_path(plan: Plan) -> fox.PosesInFrame:
    """Return the predicted track as poses oriented along the glide through water."""
    east, north, down = plan.velocity_through_water.tolist()
    poses = [
        pose(x, y, -depth, orientation(east, north, -down)) for x, y, depth in plan.track.tolist()
    ]
    return fox.PosesInFrame(timestamp=stamp(plan.start_time_ns), frame_id=FRAME, poses=poses)


def plan_geojson(plan: Plan, projection: Projection) -> fox.GeoJson:
    """Return a plan on a map."""
    return fox.GeoJson(geojson=collection_text([*plan_features(plan, projection)]))


def pose(x: float, y: float, z: float, rotation: fox.Quaternion) -> fox.Pose:
    """Return a pose in the frame ``map``."""
    return fox.Pose(position=fox.Vector3(x=x, y=y, z=z), orientation=rotation)


# a vehicle keeps its heading from one position to the next
@lru_cache(maxsize=8)
def orientation(east: float, north: float, up: float) -> fox.Quaternion:
    """Return the rotation of the x axis to a direction, without roll: yaw 0 = east, counter-clockwise, then nose up."""
    yaw, down = 0.5 * math.atan2(north, east), -0.5 * math.atan2(up, math.hypot(east, north))
    return fox.Quaternion(
        x=-math.sin(yaw) * math.sin(down),
        y=math.cos(yaw) * math.sin(down),
        z=math.sin(yaw) * math.cos(down),
        w=math.cos(yaw) * math.cos(down),
    )


def _time(time_ns: int) -> dict[str, int]:
    time = stamp(time_ns)
    return {"seconds": time.sec, "nanos": time.nsec}
