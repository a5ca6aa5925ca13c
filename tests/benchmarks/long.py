"""Long logs: a survey at 1 Hz with profiles combined against each alone, and a whole day of it."""

import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from replay_kit.config.run import RunConfig, load_config
from replay_kit.core.geodesy import rotate_to_geographic
from replay_kit.core.grid import Ensemble
from replay_kit.logs.mcap.writer import write_mcap_log
from replay_kit.studies.twins.field import Field, build_field
from replay_kit.studies.twins.make import measure, messages
from replay_kit.studies.twins.mission import Mission, as_logged
from replay_kit.workflows.replay.inputs.job import ReplayJob
from replay_kit.workflows.replay.replay import replay
from tests import synthetic
from tests.benchmarks.measure import Row, alone, row, seconds
from tests.benchmarks.scene import NOISE, withheld

_DAY = 86_400
_SPEED = 1.5  # m/s
_LEG, _APART = 20e3, 3e3  # m
_SIZES = {False: ((17, 31, 8, 50), _DAY // 10, _DAY), True: ((9, 11, 8, 20), 240, 40)}


def survey(field: Field, n: int, first: int = 0) -> Mission:
    """Return a vehicle that goes up and down parallel legs at 1.5 m/s, with a ping and a position each second from one on."""
    second = np.arange(first, first + n, dtype=np.int64)
    way = _SPEED * second
    leg, along = np.divmod(way, _LEG + _APART)
    east = np.clip(along, 0.0, _LEG) - 0.5 * _LEG
    north = leg * _APART + np.clip(along - _LEG, 0.0, _APART)
    half = 0.4 * (field.grid.north.max() - field.grid.north.min())
    # there and back where the region ends
    round_trip = north % (4.0 * half)
    north = half - np.abs(round_trip - 2.0 * half)
    across = np.where(round_trip < 2.0 * half, 0.0, 180.0)
    heading = np.where(along < _LEG, np.where(leg % 2 == 0, 90.0, 270.0), across)
    east = np.where(leg % 2 == 0, east, -east)
    place, level = np.column_stack([east, north, np.zeros(n)]), np.zeros(n)
    every = np.ones(n, dtype=np.bool_)
    time_ns, none = field.time_ns + 10**9 * second, np.empty((0, 2), dtype=np.intp)
    logged = as_logged(field, place)
    return Mission(time_ns, place, heading, level, every, logged, ~every, none, none * 1.0)


def written(values: Ensemble, path: Path) -> Path:
    """Return the file into which an ensemble was written."""
    grid = values.grid
    parts = rotate_to_geographic(
        grid.projection, grid.longitude, grid.latitude, values.velocity[:, 0], values.velocity[:, 1]
    )
    synthetic.as_forecast(parts, grid.levels, grid.latitude[:, 0], grid.longitude[0]).to_netcdf(
        path, engine="h5netcdf"
    )
    return path


def _replayed(folder: Path, log: Path, window: float | str) -> dict[str, Any]:
    """Replay in a process of its own; return its processor time, its error, the profiles used, and what its memory grew by."""
    # with the amplitude of the mean stated, the prior of both is the same: its fit and its moved centre depend on the number of profiles
    settings = {"time": {"window": window}, "estimator": {"mean_variance": 0.1}}
    config: RunConfig = load_config(None, settings)
    job = ReplayJob(
        (log,),
        folder / "ensemble.nc",
        folder / "out.mcap",
        truth=str(folder / "truth.nc"),
        overwrite=True,
    )

    def work() -> dict[str, Any]:
        took, (summary, _) = seconds(lambda: replay(job, config), clock=time.process_time)
        assert summary.truth is not None
        return {
            "seconds": took,
            "rmse": summary.truth["rmse"],
            "used": summary.observations["used"],
            "stages": dict(summary.seconds),
        }

    return alone(work)


def rows(tiny: bool) -> list[Row]:
    """Return the rows of all measurements."""
    size, part, day = _SIZES[tiny]
    members, truth = withheld(*size)
    field, found = build_field(truth), []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        written(members, folder / "ensemble.nc")
        written(truth, folder / "truth.nc")
        for n, peer in ((part, True), (day, False)):
            log, rng = folder / f"{n}.mcap", np.random.default_rng(1)
            mission = survey(field, n)
            write_mcap_log(log, messages(mission, measure(field, mission.place, NOISE, rng), NOISE))
            ours = _replayed(folder, log, "auto")
            theirs = _replayed(folder, log, 0.0) if peer else None
            error = {"unused": float(n - ours["used"])}
            if theirs is not None:
                error["rmse_changed"] = abs(ours["rmse"] / theirs["rmse"] - 1.0)
            found.append(
                row(
                    f"long: replay of {n} pings at 1 Hz, a survey, {size[1]} x {size[0]} x {size[2]}, {size[3]} members",
                    ours["seconds"],
                    "every profile alone" if peer else "none",
                    None if theirs is None else theirs["seconds"],
                    None if theirs is None else 1.0,
                    error,
                    peak_mb=ours["peak_mb"],
                    rmse=ours["rmse"],
                    **{f"{stage}_s": took for stage, took in ours["stages"].items()},
                )
            )
    return found
