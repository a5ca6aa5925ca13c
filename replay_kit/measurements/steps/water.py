"""What measurements of the water beside the vehicle's own currents change in the state; their mathematics is imported when one comes."""

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from replay_kit.config.run import MeasurementConfig, RunConfig
from replay_kit.core.geodesy import unwrap_longitude
from replay_kit.core.grid import Ensemble
from replay_kit.core.observation import (
    Flag,
    Label,
    LinearMeasurement,
    Reason,
    Source,
    VehicleState,
    usable,
)
from replay_kit.measurements.events import Event, Skipped, Used, left_out_reason
from replay_kit.measurements.messages.water import Ctd, DrifterFix, RadarCurrents
from replay_kit.measurements.steps.state import MeasurementState, Step
from replay_kit.measurements.vehicle.dives import depth_of_pressure

if TYPE_CHECKING:
    from replay_kit.measurements.section.lines import Outcome, SectionLine, Surfacing

# ns; a vehicle that has sent no sample for so long has surfaced, whether or not its log says so
_LONGEST_NS = 3 * 3600 * 10**9
_PLACE = ("longitude", "latitude", "depth")
# m/s; of currents where nothing else is known
_SPEED = 0.2
# m, and m/s
_SPACING, _TIDE = 10e3, 0.08
_MEMBERS, _COLUMNS = 4, 500
_OUTSIDE, _TOO_FAST = (
    "drifter outside the ensemble's box",
    "drifter faster than measurements.max_speed",
)
_NO_VECTOR = "no vector slower than measurements.max_speed within the ensemble's box"
_INCOMPLETE = "sample without depth, temperature, or salinity"
_AT_SURFACE, _NO_POSITION = "sample at the surface", "sample before the first position"


def for_region(config: RunConfig, ensemble: Ensemble) -> RunConfig:
    """Return the settings of a run with what measurements leave to its ensemble: how fast its currents are, where, how densely."""
    measurements, grid = config.measurements, ensemble.grid
    # some columns of some members tell as much as all of them, and a region without a CTD is not read for it
    every = 1 + math.isqrt(grid.east.size // _COLUMNS)
    squares = np.square(ensemble.velocity[:_MEMBERS, ..., ::every, ::every]).sum(axis=1)
    speed = float(np.sqrt(np.mean(squares, where=np.isfinite(squares))))
    steps = [grid.steps(axis) for axis in (0, 1)]
    longitude = unwrap_longitude(grid.longitude, grid.projection.longitude)
    found = {
        "regional_speed": speed or None,
        "surface_spacing": max(
            (2.0 * float(np.median(step)) for step in steps if step.size), default=None
        ),
        "surface_box": (
            float(longitude.min()),
            float(grid.latitude.min()),
            float(longitude.max()),
            float(grid.latitude.max()),
        ),
    }
    stated = {name: value for name in found if (value := getattr(measurements, name)) is not None}
    return config.model_copy(
        update={"measurements": measurements.model_copy(update={**found, **stated})}
    )


def _tide_of(config: MeasurementConfig) -> float:
    return _TIDE if config.surface_tide_std is None else config.surface_tide_std


def record_radar(
    state: MeasurementState, stated: RadarCurrents, source: Source, config: MeasurementConfig
) -> Step:
    """Return the state as it is, and the measurements of the radars' vectors of one time."""
    from replay_kit.measurements.surface import superobservations

    slow = np.abs(stated.value).max(axis=1) <= config.max_speed
    stated = stated.part(slow & (config.quality.use_suspect | ~stated.suspect))
    stated = stated if config.surface_box is None else stated.within(config.surface_box)
    if not stated.error_std.size:
        return state, [Skipped(source.topic, _NO_VECTOR)]
    label = Label(state.dive, source, kind=stated.kind)
    made = superobservations(stated, label, config.surface_spacing or _SPACING, _tide_of(config))
    return state, [Used(source.topic), *made]


def record_measurement(
    state: MeasurementState, stated: LinearMeasurement, source: Source, config: MeasurementConfig
) -> Step:
    """Return the state as it is, and what a sensor of another package measured at the time of its message."""
    del config
    kind = stated.label.kind or "sensors"
    label = replace(stated.label, dive=state.dive, source=source, kind=kind)
    placed = _with_places(stated)
    return state, [Used(source.topic), replace(placed, time_ns=source.time_ns, label=label)]


def _with_places(stated: LinearMeasurement) -> LinearMeasurement:
    """Return a measurement with those values flagged that have no place, or one above the surface."""
    points = stated.longitude + stated.latitude + stated.depth
    unknown, above, weights = ~np.isfinite(points), stated.depth < 0.0, stated.weights
    if weights is not None:
        # a point without a place is no point of the sums that do not use it, either
        stated = replace(
            stated,
            **{name: np.nan_to_num(getattr(stated, name)) for name in _PLACE},
        )
        unknown, above = ((weights != 0.0) @ each for each in (unknown, above))
    flags = np.where(above & usable(stated.flags), Flag.FAIL, stated.flags)
    reasons = Reason.ABOVE_SURFACE * above + Reason.MISSING * unknown
    return replace(
        stated,
        flags=np.where(unknown, Flag.MISSING, flags).astype(np.int8),
        reasons=(stated.reasons | reasons).astype(np.int32),
    )


def record_drifter(
    state: MeasurementState, stated: DrifterFix, source: Source, config: MeasurementConfig
) -> Step:
    """Return the state after a drifter's fix, and the mean current since one of its fixes before."""
    from replay_kit.measurements.surface import Errors, displacement, is_over

    if config.surface_box is not None:
        west, south, east, north = config.surface_box
        inside = (stated.longitude - west) % 360.0 <= (east - west) % 360.0
        if not (inside and south <= stated.latitude <= north):
            return state, [Skipped(source.topic, _OUTSIDE)]
    before = state.drifters.get(stated.name)
    made = None
    if before is not None:
        errors = Errors(config.fix_std, _tide_of(config))
        made = displacement(before, (source, stated), errors, state.dive)
    if made is not None and np.abs(made.value).max() > config.max_speed:
        return state, [Skipped(source.topic, _TOO_FAST)]
    if made is not None or before is None or is_over(before[0], source):
        state = replace(state, drifters={**state.drifters, stated.name: (source, stated)})
    return state, [Used(source.topic), *([] if made is None else [made])]


def record_ctd(
    state: MeasurementState, stated: Ctd, source: Source, config: MeasurementConfig
) -> Step:
    """Return the state after a sample of the CTD; what becomes of it is known when its line is complete."""
    if "shear" in config.without:
        return state, [Skipped(source.topic, left_out_reason(("shear",)))]
    from replay_kit.measurements.section.lines import SectionLine

    depth = stated.depth
    if not math.isfinite(depth):
        depth = depth_of_pressure(stated.pressure, state.latitude)
    known = math.isfinite(stated.salinity) or math.isfinite(stated.conductivity)
    if not (known and math.isfinite(depth + stated.temperature)):
        return state, [Skipped(source.topic, _INCOMPLETE)]
    if depth < config.surface_depth:
        return state, [Skipped(source.topic, _AT_SURFACE)]
    if state.fix is None:
        return state, [Skipped(source.topic, _NO_POSITION)]
    line, events = state.line or SectionLine(), list[Event]()
    if line.cast.samples and source.time_ns > line.cast.last_ns + _LONGEST_NS:
        line, events = _after_dive(state, line, None, config)
    values = (depth, stated.temperature, stated.salinity, stated.conductivity, stated.pressure)
    line = replace(line, cast=line.cast.after(source, state.fix, values))
    return replace(state, line=line), [*events]


def surfaced(state: MeasurementState, config: MeasurementConfig) -> Step:
    """Return the state after a position at the surface, and what the dive before it gave."""
    line, fix = state.line, state.fix
    if line is None or not line.cast.samples or fix is None:
        return state, []
    line, events = _after_dive(state, line, None if fix.dead_reckoned else fix, config)
    return replace(state, line=line), [*events]


def unfinished(state: MeasurementState, config: MeasurementConfig) -> list[Event]:
    """Return the events of a line that is not complete when the log ends."""
    from replay_kit.measurements.section.lines import close

    line, events = state.line, list[Event]()
    if line is None:
        return events
    if line.cast.samples:
        line, events = _after_dive(state, line, None, config)
    _, outcomes = close(line, _surfacing(state, None, config))
    return events + _events(outcomes)


def _after_dive(
    state: MeasurementState,
    line: "SectionLine",
    fix: VehicleState | None,
    config: MeasurementConfig,
) -> tuple["SectionLine", list[Event]]:
    """Return a line after a dive, which ends at a fix or without one, and the events of the messages that are decided."""
    from replay_kit.measurements.section.lines import after_dive

    line, outcomes = after_dive(line, _surfacing(state, fix, config))
    return line, _events(outcomes)


def _surfacing(
    state: MeasurementState, fix: VehicleState | None, config: MeasurementConfig
) -> "Surfacing":
    from replay_kit.measurements.section.lines import Surfacing

    assert state.fix is not None, "samples before the first position are not used"
    speed = config.regional_speed or _SPEED
    return Surfacing(state.fix.time_ns, state.dive, fix, config.surface_depth, speed)


def _events(outcomes: "Iterable[Outcome]") -> list[Event]:
    """Return an event for each message, and the measurements that they gave."""
    events: list[Event] = []
    for each in outcomes:
        one = Skipped(each.topic, each.reason) if each.reason else Used(each.topic)
        events += [one] * each.messages
        events += [] if each.shear is None else [each.shear]
    return events
