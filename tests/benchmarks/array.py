"""Several gliders with one estimate beside each alone: members are left out in turn, and twins fly distinct courses through them.

``python -m tests.benchmarks array`` writes a row for each sea, kind of measurement and number of gliders; the last is 50 gliders of 30
days, in a process of its own.
"""

import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from replay_kit.config.run import EstimatorConfig, ForecastConfig, RunConfig
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.grid import Ensemble
from replay_kit.estimator import build_estimator
from replay_kit.forecast import read_ensemble
from replay_kit.results.outcome.run import ReplaySummary
from replay_kit.studies.twins.truths import leave_out
from replay_kit.workflows.replay.inputs.forecast import Forecasts
from replay_kit.workflows.replay.inputs.job import ReplayJob, Vehicle
from replay_kit.workflows.replay.replay import replay
from tests import synthetic
from tests.arrays import write_array
from tests.benchmarks.measure import Row, alone, row
from tests.places import DATA, SAMPLES

SEAS = {
    "sample": SAMPLES / "ensemble.nc",
    "quasi-geostrophic": DATA / "qg" / "forecast.nc",
    "North Atlantic": DATA / "natl_nemo" / "ensemble.nc",
}
_COUNTS, _TRUTHS, _MODES = (2, 3, 4, 6), 6, 40
# Pings of each glider, one in ten minutes: without and with an ADCP.
_PINGS = {True: 200, False: 100}
_HALF = 1.6449
_VEHICLES, _DAYS = 50, 30


def rows(tiny: bool) -> list[Row]:
    """Return what was measured."""
    seas = {name: path for name, path in SEAS.items() if path.exists()}
    if tiny:
        small = synthetic.ensemble(n_members=6, shape=(8, 9))
        return [_row("synthetic", small, True, 2, 1, 6, 40)]
    found = [
        _row(name, ensemble, dac_only, count, _TRUTHS, _MODES, _PINGS[dac_only])
        for name, path in seas.items()
        for ensemble in (read_ensemble(path, ForecastConfig()),)
        for dac_only in (True, False)
        for count in _COUNTS
    ]
    return [*found, _many()]


def _row(
    sea: str, ensemble: Ensemble, dac_only: bool, count: int, truths: int, modes: int, pings: int
) -> Row:
    config, cases = RunConfig(estimator=EstimatorConfig(modes=modes)), []
    spent = 0.0
    for member in range(truths):
        case = leave_out(ensemble, member)
        estimator = build_estimator(case.ensemble, config.estimator)
        forecasts = Forecasts((case.ensemble,), case.ensemble, False)
        with tempfile.TemporaryDirectory() as folder:
            logs = write_array(Path(folder), case.truth, count, pings, dac_only)

            def run(
                given: Mapping[str, Path], estimator: Any = estimator, forecasts: Any = forecasts
            ) -> tuple[ReplaySummary, FlowEstimate]:
                vehicles = tuple(Vehicle(name, (path,)) for name, path in given.items())
                paths = tuple(given.values())
                own = vehicles if len(vehicles) > 1 else ()
                job = ReplayJob(paths, paths[0], vehicles=own, estimator=lambda *_: estimator)
                return replay(job, config, forecasts=forecasts)

            begin = time.process_time()
            pooled = run(logs)
            spent += time.process_time() - begin
            singles = [run({name: path}) for name, path in logs.items()]
        cases.append(_case(case.truth, pooled, singles))
    table = {name: np.array([one[name] for one in cases]) for name in cases[0]}
    mean = {name: float(np.mean(values)) for name, values in table.items()}
    what = "mean currents" if dac_only else "with an ADCP"
    return row(
        f"{sea}, {what}, {count} gliders, {truths} truths: below the mean of singles .95, below the chosen one .8, nis .9-1.1",
        spent / truths,
        "each alone",
        error=mean
        | {
            "below_mean": float(np.mean(table["pooled"] < table["singles"])),
            "below_chosen": float(np.mean(table["pooled"] < table["chosen"])),
        },
    )


def _case(
    truth: Ensemble,
    pooled: tuple[ReplaySummary, FlowEstimate],
    singles: list[tuple[ReplaySummary, FlowEstimate]],
) -> dict[str, float]:
    summary, flow = pooled
    errors = [_scores(one, truth)[0] for _, one in singles]
    evidence = [
        one.evidence.total.log_evidence / one.evidence.total.measurements if one.evidence else 0.0
        for one, _ in singles
    ]
    rmse, covered = _scores(flow, truth)
    return {
        "pooled": rmse,
        "singles": float(np.mean(errors)),
        "chosen": errors[int(np.argmax(evidence))],
        "nis": summary.nis_per_dof,
        "covered": covered,
        "findings": float(sum(len(one.findings) for one in summary.vehicles.values())),
    }


def _scores(flow: FlowEstimate, truth: Ensemble) -> tuple[float, float]:
    """Return the RMS length of the error over the wet points [m/s], and the share of components in their 90 % intervals."""
    grid, squares, inside = truth.grid, [], []
    for k, level in enumerate(grid.levels):
        wet = grid.wet[k]
        at = grid.east[wet], grid.north[wet], np.full(int(wet.sum()), float(level))
        off = flow.velocity(*at) - truth.velocity[0, :, k][:, wet].T
        squares.append(np.sum(off**2, axis=1))
        inside.append(np.abs(off) <= _HALF * flow.standard_error(*at))
    return float(np.sqrt(np.mean(np.concatenate(squares)))), float(np.mean(np.concatenate(inside)))


def _many() -> Row:
    """Return time and memory of many gliders of a month, without what makes their logs."""
    ensemble = read_ensemble(SAMPLES / "ensemble.nc", ForecastConfig())
    with tempfile.TemporaryDirectory() as folder:
        logs = write_array(
            Path(folder), leave_out(ensemble, 0).truth, _VEHICLES, _DAYS * 144, dac_only=True
        )
        return alone(lambda: _replay_many(list(logs.values())))


def _replay_many(paths: list[Path]) -> Row:
    vehicles = tuple(Vehicle(path.stem, (path,)) for path in paths)
    begin = time.process_time()
    replay(ReplayJob(tuple(paths), SAMPLES / "ensemble.nc", vehicles=vehicles), RunConfig())
    name = f"{_VEHICLES} gliders, {_DAYS} days of mean currents: 300 s, 1000 MB asked"
    return row(name, time.process_time() - begin)
