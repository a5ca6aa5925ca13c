"""Currents by radar in the estimate: real totals and radials of which half is withheld, two made stations, a glider under a radar.

The prior of the real currents is a synthetic ensemble at their place, scaled to the RMS speed of the first two hours; no current of a
later hour is in it. The model of time is that of six under which the first two hours are likeliest. Half of the cells is withheld in the
six hours after, in squares of 30 km or one by one; scored is the current at the surface in the result of a replay of the others.
"""

import tempfile
import time
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator

from replay_kit.config.estimation import GatingConfig, TimeConfig
from replay_kit.config.run import EstimatorConfig, ForecastConfig, load_config
from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.geodesy import to_geographic, to_local
from replay_kit.core.grid import Ensemble
from replay_kit.core.message import Message
from replay_kit.core.observation import LinearMeasurement, Observation, PathMean
from replay_kit.estimator import build_estimator
from replay_kit.estimator.evolving.build import build_evolving
from replay_kit.forecast import read_ensemble, read_truth
from replay_kit.logs import merge, open_logs
from replay_kit.logs.mcap.writer import write_mcap_log
from replay_kit.measurements.interpret import events_of
from replay_kit.measurements.steps.water import for_region
from replay_kit.studies.twins.ensemble import write_ensemble
from replay_kit.studies.twins.field import build_field
from replay_kit.workflows.replay.inputs.forecast import Forecasts
from replay_kit.workflows.replay.inputs.job import ReplayJob
from replay_kit.workflows.replay.replay import replay
from replay_kit.workflows.sound import open_result
from tests.benchmarks.measure import Row, row
from tests.places import DATA

_REAL = DATA / "hfradar"
_FIRST, _HOURS, _SQUARE = 2, 6, 30e3
_START, _HOUR = 1_600_000_000 * 10**9, 3600 * 10**9
_NO_TIDE = {"measurements": {"surface_tide_std": 0.0}}
# what turns with the tide and with the earth is the same over the region; without it tides are an error of the vectors
_TIMES = [
    TimeConfig(scale=scale, oscillators=names)
    for scale in (10_800.0, 21_600.0, 86_400.0)
    for names in (("inertial", "M2"), ())
]


def _prior(folder: Path, place: tuple[float, float], speed: float) -> Ensemble:
    """Return what a synthetic ensemble is about its mean, which is of another place, with an RMS speed at the surface [m/s]."""
    write_ensemble(folder / "ensemble.nc", folder / "truth.nc", overwrite=True)
    found = read_ensemble(folder / "ensemble.nc", ForecastConfig(), place_at=place)
    velocity = found.velocity - found.velocity.mean(axis=0)
    surface = np.sqrt(np.mean(np.sum(velocity[:, :, 0] ** 2, axis=1)))
    return replace(found, velocity=velocity * speed / surface)


def _columns(message: Message) -> dict[str, Array]:
    return {name: np.array(each) for name, each in message.payload.items() if type(each) is list}


def _part(message: Message, chosen: Array) -> Message:
    """Return a message with some of its vectors or radials."""
    part = {name: values[chosen].tolist() for name, values in _columns(message).items()}
    return message._replace(payload={**message.payload, **part})


def _flows(
    ensemble: Ensemble, messages: Iterable[Message], time: TimeConfig
) -> tuple[list[FlowEstimate], float]:
    """Return the estimate after each message, and the log evidence of all."""
    estimator = build_evolving([ensemble], EstimatorConfig(), time, GatingConfig())
    settings = load_config(None, _NO_TIDE if time.oscillators else {})
    measured, found = for_region(settings, ensemble).measurements, []
    state, evidence = estimator.initial(), 0.0
    for events in events_of(messages, measured):
        for each in events:
            if isinstance(each, LinearMeasurement):
                state, innovation = estimator.step(state, each)
                evidence += innovation.log_likelihood
        found.append(estimator.flow(state))
    return found[:-1], evidence


def _likeliest(ensemble: Ensemble, messages: Sequence[Message]) -> TimeConfig:
    """Return the model of time with the largest log evidence."""
    return max(_TIMES, key=lambda time: _flows(ensemble, messages, time)[1])


def _surface(flow: FlowEstimate, message: Message) -> tuple[Array, Array]:
    """Return the current at a message's places, and its standard error, shapes (n, 2) [m/s]."""
    columns, later = _columns(message), flow.later
    found = flow.velocity_at(columns["longitude"], columns["latitude"], message.payload["depth"])
    velocity = np.column_stack([found.u, found.v])
    if later.oscillation is not None:
        # within a hundred kilometres of the centre, local axes turn from true ones by less than half a degree
        velocity = velocity + later.oscillation.velocity(message.time_ns)[:, 0]
    return velocity, np.column_stack([found.u_standard_error, found.v_standard_error])


def _within(ensemble: Ensemble, message: Message) -> Message:
    """Return a message with what lies in the middle of an ensemble's region, a cell from its edges."""
    columns, grid = _columns(message), ensemble.grid
    x, y = to_local(grid.projection, columns["longitude"], columns["latitude"])
    low, high = (f([grid.east.ravel(), grid.north.ravel()], axis=1) for f in (np.min, np.max))
    margin = 0.05 * (high - low)
    inside = (np.column_stack([x, y]) > low + margin) & (np.column_stack([x, y]) < high - margin)
    return _part(message, inside.all(axis=1))


def _withheld(message: Message, how: str) -> Array:
    """Return which cells are withheld: every other square of 30 km, or half of the cells at random, the same at all times."""
    columns = _columns(message)
    east = 111.2e3 * np.cos(np.deg2rad(40.0)) * columns["longitude"]
    north = 111.2e3 * columns["latitude"]
    if how == "squares":
        return np.asarray((np.floor(east / _SQUARE) + np.floor(north / _SQUARE)) % 2 == 0)
    # of a cell's place alone, as cells come and go
    cells = np.round(1e3 * np.column_stack([columns["longitude"], columns["latitude"]]))
    return np.array([np.random.default_rng(abs(each)).random() < 0.5 for each in cells.astype(int)])


def _vectors(message: Message) -> tuple[Array, Array]:
    """Return places [degrees] and vectors [m/s], shapes (n, 2)."""
    columns = _columns(message)
    return tuple(  # type: ignore[return-value]
        np.column_stack([columns[name] for name in names])
        for names in (("longitude", "latitude"), ("east", "north"))
    )


def _interpolated(places: Array, values: Array, at: Array) -> Array:
    """Return values interpolated linearly between their places, outside of them those of the nearest."""
    linear = LinearNDInterpolator(places, values)(at)
    nearest = NearestNDInterpolator(places, values)(at)
    return np.where(np.isfinite(linear), linear, nearest)


def _replayed(
    folder: Path, ensemble: Ensemble, messages: Sequence[Message], time: TimeConfig
) -> pd.DataFrame:
    """Return the current at the surface in the result of a replay; the folder holds the ensemble's file."""
    config = load_config(None, _NO_TIDE if time.oscillators else {})
    config = config.model_copy(update={"time": time})
    log, out = folder / "log.mcap", folder / "out.mcap"
    write_mcap_log(log, messages)
    job = ReplayJob((log,), folder / "ensemble.nc", out, overwrite=True)
    replay(job, config, forecasts=Forecasts((ensemble,), ensemble, True))
    return open_result(out).surface


def totals_row(how: str) -> Row:
    """Half of the real totals withheld in six hours: a replay, the estimate alone, interpolation, the last whole hour."""
    began, messages = time.process_time(), list(merge(open_logs(sorted(_REAL.glob("RU*.nc"))), 1.0))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        ensemble = _prior(folder, (-72.8, 39.95), 1.0)
        whole = [_within(ensemble, each) for each in messages[: _FIRST + _HOURS]]
        known = np.concatenate([_vectors(each)[1] for each in whole[:_FIRST]])
        speed = float(np.sqrt(np.mean(np.sum(known**2, axis=1))))
        ensemble = replace(ensemble, velocity=speed * ensemble.velocity)
        given = [
            each if hour < _FIRST else _part(each, ~_withheld(each, how))
            for hour, each in enumerate(whole)
        ]
        through = _likeliest(ensemble, whole[:_FIRST])
        surface = _replayed(folder, ensemble, given, through)
    flows, _ = _flows(ensemble, given, through)
    before = _vectors(whole[_FIRST - 1])
    squares: dict[str, list[Array]] = {
        name: [] for name in ("estimate_alone", "replayed", "interpolated", "persisted")
    }
    held = []
    for hour in range(_FIRST, _FIRST + _HOURS):
        hidden = _part(whole[hour], _withheld(whole[hour], how))
        at, truth = _vectors(hidden)
        cells = surface.loc[pd.Timestamp(hidden.time_ns)]
        values = cells[["u", "v", "u_standard_error", "v_standard_error"]].to_numpy()
        found = _interpolated(cells[["longitude", "latitude"]].to_numpy(), values, at)
        held.append(np.abs(found[:, :2] - truth) < 1.645 * found[:, 2:])
        for name, one in {
            "estimate_alone": _surface(flows[hour], hidden)[0],
            "replayed": found[:, :2],
            "interpolated": _interpolated(*_vectors(given[hour]), at),
            "persisted": _interpolated(*before, at),
        }.items():
            squares[name].append((one - truth) ** 2)
    rms = {
        f"{name}_m_s": float(np.sqrt(np.mean(np.vstack(each)))) for name, each in squares.items()
    }
    name = f"radar totals of six hours, half withheld by {how}: below interpolation and persistence asked"
    return row(
        name,
        time.process_time() - began,
        error={**rms, "within_90": float(np.mean(np.vstack(held)))},
        cells=sum(len(each) for each in held),
    )


def _toward(message: Message) -> Array:
    """Return the unit vectors along which radials are positive, shape (n, 2)."""
    angle = np.deg2rad(_columns(message)["direction"])
    return np.column_stack([np.sin(angle), np.cos(angle)])


def radials_row() -> Row:
    """The radials of one station every three hours, half of them withheld at random: are they predicted within the stated error?"""
    began, messages = time.process_time(), list(merge(open_logs(sorted(_REAL.glob("*.ruv"))), 1.0))
    first = _columns(messages[0])
    place = float(first["longitude"].mean()), float(first["latitude"].mean())
    # a radial has one of two components
    speed = float(np.sqrt(2.0 * np.mean(first["speed"] ** 2)))
    with tempfile.TemporaryDirectory() as folder:
        ensemble = _prior(Path(folder), place, speed)
    whole, rng = [_within(ensemble, each) for each in messages], np.random.default_rng(1)
    hidden = [rng.random(len(_columns(each)["speed"])) < 0.5 for each in whole]
    pairs = list(zip(whole, hidden, strict=True))
    given = [_part(each, ~chosen) for each, chosen in pairs]
    flows, _ = _flows(ensemble, given, _likeliest(ensemble, given[:1]))
    off, stated = [], []
    for flow, (each, chosen) in zip(flows, pairs, strict=True):
        withheld = _part(each, chosen)
        columns, toward = _columns(withheld), _toward(withheld)
        found, std = _surface(flow, withheld)
        off.append(np.sum(toward * found, axis=1) - columns["speed"])
        stated.append(np.sqrt(np.sum((toward * std) ** 2, axis=1) + columns["error"] ** 2))
    errors, std = np.concatenate(off), np.concatenate(stated)
    figures = {
        "actual_m_s": float(np.sqrt(np.mean(errors**2))),
        "stated_m_s": float(np.sqrt(np.mean(std**2))),
        "within_90": float(np.mean(np.abs(errors) < 1.645 * std)),
    }
    name = f"radials of one station, {len(errors)} of them withheld: within the stated error asked"
    return row(name, time.process_time() - began, error=figures)


def _made(truth: Ensemble, time_ns: int, rng: np.random.Generator, station: int = -1) -> Message:
    """Return what radars see of a truth's surface on a grid of 6 km: total vectors, or radials of a station in the west or north."""
    grid = truth.grid
    nodes = np.stack(np.meshgrid(*(np.arange(-k, k, 6e3) for k in (60e3, 36e3))), axis=-1)
    places = nodes.reshape(-1, 2)
    longitude, latitude = to_geographic(grid.projection, *places.T)
    # within a hundred kilometres of the centre, local axes turn from true ones by less than half a degree
    true = build_field(truth).velocity(*places.T, 0.0)
    common = {"longitude": longitude, "latitude": latitude}
    if station < 0:
        seen = true + 0.06 * rng.standard_normal(true.shape)
        errors = dict.fromkeys(("east_error", "north_error"), np.full(len(true), 0.06))
        columns = {**common, "east": seen[:, 0], "north": seen[:, 1], **errors}
    else:
        way = np.array([[-90e3, -10e3], [10e3, 70e3]])[station] - places
        toward = way / np.linalg.norm(way, axis=1, keepdims=True)
        speed = np.sum(true * toward, axis=1) + 0.06 * rng.standard_normal(len(true))
        direction = np.rad2deg(np.arctan2(*toward.T)) % 360.0
        columns = {
            **common,
            "speed": speed,
            "direction": direction,
            "error": np.full(len(true), 0.06),
        }
    payload = {"depth": 1.0, "averaged": 3600.0, "error_length": 0.0}
    payload |= {name: values.tolist() for name, values in columns.items()}
    topic = "/radar/totals" if station < 0 else f"/radar/radials/{station}"
    return Message(time_ns, topic, "replay_kit.RadarCurrents", payload, 0, 0)


def _dives(truth: Ensemble, rng: np.random.Generator) -> list[PathMean]:
    """Return the mean currents to 500 m of ten dives eastward through the middle."""
    depth, found = np.linspace(5.0, 500.0, 20), []
    for k in range(10):
        at = -40e3 + 8e3 * k
        mean = build_field(truth).velocity(at, 0.0, depth).mean(axis=0)
        mean = mean + 0.02 * rng.standard_normal(2)
        longitude, latitude = to_geographic(truth.grid.projection, at, 0.0)
        ends = [(_START + (4 * k + e) * _HOUR, float(longitude), float(latitude)) for e in (0, 3)]
        found.append(Observation.mean(*ends, 500.0, *mean.tolist(), 0.02))
    return found


def _twin(seed: int) -> dict[str, float]:
    """Return mean squared errors in the middle of a truth [m2/s2], at the surface and at 200 m, by what was given to the estimate."""
    rng = np.random.default_rng(seed)
    with tempfile.TemporaryDirectory() as name:
        paths = Path(name) / "ensemble.nc", Path(name) / "truth.nc"
        write_ensemble(*paths, seed=seed)
        ensemble = read_ensemble(paths[0], ForecastConfig())
        truth = read_truth(str(paths[1]), ForecastConfig())
    estimator = build_estimator(ensemble, EstimatorConfig(), GatingConfig())
    config = for_region(load_config(None, _NO_TIDE), ensemble).measurements
    x, y = (
        each.ravel() for each in np.meshgrid(np.arange(-45e3, 46e3, 15e3), np.arange(-1, 2) * 15e3)
    )
    field = build_field(truth)

    def seen(*stations: int) -> list[LinearMeasurement]:
        messages = [_made(truth, _START + 40 * _HOUR, rng, one) for one in stations]
        events = (each for some in events_of(messages, config) for each in some)
        return [each for each in events if isinstance(each, LinearMeasurement)]

    dives, totals = _dives(truth, rng), seen(-1)
    found = {}
    for name, given in {
        "prior": [],
        "totals": totals,
        "stations": seen(0, 1),
        "glider": dives,
        "both": [*dives, *totals],
    }.items():
        state = estimator.initial()
        for each in given:
            state, _ = estimator.step(state, each)
        flow = estimator.flow(state)
        for depth in (0.0, 200.0):
            off = flow.velocity(x, y, depth) - field.velocity(x, y, depth)
            found[f"{name}_{depth:g}m"] = float(np.mean(off**2))
    return found


def twins_row(count: int) -> Row:
    """Truths of synthetic seas: what two stations' radials give beside totals, and what totals add to a glider's mean currents."""
    began = time.process_time()
    found = [_twin(seed) for seed in range(count)]
    error = {key: float(np.sqrt(np.mean([one[key] for one in found]))) for key in found[0]}
    name = f"{count} twins, error [m/s]: totals or the radials of two stations; a glider's mean currents, with totals"
    return row(name, time.process_time() - began, error=error)


def rows(tiny: bool) -> list[Row]:
    """Return what was measured."""
    if tiny:
        return [twins_row(1)]
    found = [totals_row("squares"), totals_row("cells"), radials_row()] if _REAL.exists() else []
    return [*found, twins_row(6)]
