"""Several gliders with one estimate beside each alone: members are left out in turn, and twins fly distinct courses through them.

``python -m tests.benchmarks array`` writes a row for each sea, kind of measurement and number of gliders; two on what the checks say of
sound arrays and of one compass that is turned; 50 gliders of 30 days, in a process of its own; and two pairs of gliders in a sea of a
basin's size, which windows follow.
"""

import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from replay_kit.config.run import EstimatorConfig, ForecastConfig, RunConfig
from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.geodesy import rotate_to_geographic, to_local
from replay_kit.core.grid import Ensemble
from replay_kit.estimator import build
from replay_kit.forecast import read_ensemble
from replay_kit.results.outcome.outcome import Outcome
from replay_kit.show.notebook import Result, read_result
from replay_kit.studies.twins.field import build_field
from replay_kit.studies.twins.truths import leave_out
from replay_kit.workflows.replay.inputs.forecast import Forecasts
from replay_kit.workflows.replay.inputs.job import ReplayJob, Vehicle
from replay_kit.workflows.replay.replay import replay
from tests import synthetic
from tests.arrays import write_array
from tests.benchmarks.measure import Row, alone, row, runner
from tests.benchmarks.windows import LEVELS, QUICK, Strip, sea
from tests.faulty import Faults
from tests.places import DATA, SAMPLES

SEAS = {
    "sample": SAMPLES / "ensemble.nc",
    "quasi-geostrophic": DATA / "qg" / "forecast.nc",
    "North Atlantic": DATA / "natl_nemo" / "ensemble.nc",
}
_TRUTHS = 10
# Which of six gliders fly together, by their number.
_TOGETHER = {2: (0, 3), 3: (0, 2, 4), 4: (0, 1, 3, 4), 6: (0, 1, 2, 3, 4, 5)}
# Pings of each glider, one in ten minutes: without and with an ADCP.
_PINGS = {True: 200, False: 100}
_HALF = 1.6449
# Arrays whose findings are counted, their pings and modes; a compass is turned by so much [degrees].
_ARRAYS, _CHECKED_PINGS, _CHECKED_MODES, _TURNED = 100, 150, 20, 40.0
_VEHICLES, _DAYS = 50, 30
_DEFAULT = RunConfig()
# A sea of 2,100 by 1,100 km, and the courses of two pairs that fly through each other's water.
_BASIN, _BASIN_PINGS, _SMALL = (
    Strip(120, 300, 30, 2.5, 1600, 0),
    10 * 144,
    Strip(12, 104, 10, 1.2, 300, 0),
)
_PAIRS = tuple(
    ((row, column), (row + 0.05, column + 0.04), (row, column + 0.08))
    for row, column in ((0.3, 0.15), (0.34, 0.17), (0.6, 0.75), (0.64, 0.77))
)
# What replays a job of some logs.
_Outcome = tuple[Outcome, FlowEstimate]


def rows(tiny: bool) -> list[Row]:
    """Return what was measured."""
    seas = {name: path for name, path in SEAS.items() if path.exists()}
    if tiny:
        small = synthetic.ensemble(n_members=6, shape=(8, 9))
        config = RunConfig(estimator=EstimatorConfig(modes=6))
        quick = RunConfig(estimator=QUICK, forecast=ForecastConfig(window_points=_SMALL.window))
        together = beside_singles("synthetic", small, {2: (0, 3)}, range(1), 40, config)
        return [*together, in_basin(_SMALL, 20, quick, runner(tiny))]
    found = [
        each
        for name, path in seas.items()
        for dac_only in (True, False)
        for each in beside_singles(
            name, _read(path), _TOGETHER, range(_TRUTHS), _PINGS[dac_only], dac_only=dac_only
        )
    ]
    checked = (findings_of(turned, range(_ARRAYS)) for turned in (False, True))
    return [*found, *checked, many(), in_basin(_BASIN, _BASIN_PINGS, _DEFAULT)]


def beside_singles(
    sea: str,
    ensemble: Ensemble,
    together: Mapping[int, tuple[int, ...]],
    truths: Iterable[int],
    pings: int,
    config: RunConfig = _DEFAULT,
    dac_only: bool = True,
) -> Iterator[Row]:
    """Yield a row for each number of gliders: their one estimate beside those of each alone."""
    cases: dict[int, list[dict[str, float]]] = {count: [] for count in together}
    begin = time.process_time()
    for member in truths:
        case = leave_out(ensemble, member)
        with tempfile.TemporaryDirectory() as folder:
            # each truth has errors of its own: one draw would move all rows together
            of_all = write_array(Path(folder), case.truth, 6, pings, dac_only, seed=member)
            logs = list(of_all.values())
            run = _replays(case.ensemble, config)
            singles = {
                k: run([logs[k]]) for k in sorted({k for each in together.values() for k in each})
            }
            for count, numbers in together.items():
                pooled = run([logs[k] for k in numbers])
                cases[count].append(_case(case.truth, pooled, [singles[k] for k in numbers]))
    what = "mean currents" if dac_only else "with an ADCP"
    for count, found in cases.items():
        table = {name: np.array([one[name] for one in found]) for name in found[0]}
        yield row(
            f"{sea}, {what}, {count} gliders, {len(found)} truths: below the mean of singles .95, below the chosen one .8, "
            "nis .9-1.1, covered .85-.95",
            (time.process_time() - begin) / len(found),
            "each alone",
            error={name: float(np.mean(values)) for name, values in table.items()}
            | {
                "below_mean": float(np.mean(table["pooled"] < table["singles"])),
                "below_chosen": float(np.mean(table["pooled"] < table["chosen"])),
            },
        )


def _replays(ensemble: Ensemble, config: RunConfig) -> Any:
    """Return what replays logs, each of a vehicle of its own, with an estimator that is built once."""
    estimator = build([ensemble], config.estimator, config.gating)
    forecasts = Forecasts((ensemble,), ensemble, False)

    def run(paths: list[Path]) -> _Outcome:
        own = tuple(Vehicle(path.stem, (path,)) for path in paths) if len(paths) > 1 else ()
        job = ReplayJob(tuple(paths), paths[0], vehicles=own, estimator=lambda *_: estimator)
        return replay(job, config, forecasts=forecasts)

    return run


def _case(truth: Ensemble, pooled: _Outcome, singles: list[_Outcome]) -> dict[str, float]:
    outcome, flow = pooled
    errors = [_scores(one, truth)[0] for _, one in singles]
    evidence = [one.evidence["per_measurement"] if one.evidence else 0.0 for one, _ in singles]
    rmse, covered = _scores(flow, truth)
    return {
        "pooled": rmse,
        "singles": float(np.mean(errors)),
        "chosen": errors[int(np.argmax(evidence))],
        "nis": outcome.nis_per_dof or float("nan"),
        "covered": covered,
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


def findings_of(turned: bool, arrays: Iterable[int]) -> Row:
    """Return of how many arrays of three gliders with ADCPs a sound one was blamed, and the turned one of three was named.

    Args:
        turned: Whether the compass of one is, by 40 degrees.
        arrays: Their numbers: of the member that is the truth, and of the glider.
    """
    ensemble, config = (
        _read(SEAS["sample"]),
        RunConfig(estimator=EstimatorConfig(modes=_CHECKED_MODES)),
    )
    blamed, named, begin, of = 0, 0, time.process_time(), list(arrays)
    for number in of:
        case, bad = leave_out(ensemble, number % ensemble.n_members), number % 3
        faults = {bad: Faults("platform", 0.02, heading_bias_deg=_TURNED)} if turned else None
        with tempfile.TemporaryDirectory() as folder:
            logs = write_array(
                Path(folder), case.truth, 3, _CHECKED_PINGS, faults=faults, seed=number
            )
            outcome, _ = _replays(case.ensemble, config)(list(logs.values()))
        found = {name for name, one in outcome.vehicles.items() if one.consistency}
        named += f"sg{bad + 1}" in found
        blamed += bool(found - ({f"sg{bad + 1}"} if turned else set()))
    what = "one of three compasses turned: named .95" if turned else "three sound gliders: blamed 0"
    error = {"blamed": blamed / len(of)} | ({"named": named / len(of)} if turned else {})
    return row(f"{len(of)} arrays, {what}", (time.process_time() - begin) / len(of), error=error)


def many(vehicles: int = _VEHICLES, days: int = _DAYS) -> Row:
    """Return time and memory of many gliders of a month, without what makes their logs."""
    ensemble = _read(SEAS["sample"])
    with tempfile.TemporaryDirectory() as folder:
        truth = leave_out(ensemble, 0).truth
        logs = write_array(Path(folder), truth, vehicles, days * 144, dac_only=True)

        def work() -> Row:
            own = tuple(Vehicle(path.stem, (path,)) for path in logs.values())
            begin = time.process_time()
            replay(ReplayJob(tuple(logs.values()), SEAS["sample"], vehicles=own), _DEFAULT)
            name = f"{vehicles} gliders, {days} days of mean currents: 300 s, 1000 MB asked"
            return row(name, time.process_time() - begin)

        return alone(work)


def in_basin(
    strip: Strip, pings: int, config: RunConfig, run: Callable[[Callable[[], Row]], Row] = alone
) -> Row:
    """Return the error about the tracks of two pairs of gliders far apart, in windows, beside that of each alone."""
    of = sea(strip)
    truth = of.part(None, slice(strip.members, None))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        members = np.moveaxis(of.velocity[: strip.members], 1, 0)
        forecast = synthetic.as_forecast(members, LEVELS, of.latitude, of.longitude)
        forecast.to_netcdf(folder / "ensemble.nc", engine="h5netcdf")
        logs = write_array(folder, truth, 4, pings, dac_only=True, courses=_PAIRS)

        def replayed(names: Sequence[str]) -> Callable[[], Row]:
            own = tuple(Vehicle(one, (logs[one],)) for one in names) if len(names) > 1 else ()
            paths, out = tuple(logs[one] for one in names), folder / f"{'-'.join(names)}.out.mcap"
            job = ReplayJob(paths, folder / "ensemble.nc", out, vehicles=own)

            def work() -> Row:
                begin = time.process_time()
                replay(job, config)
                return row("", time.process_time() - begin)

            return work

        found, singles = run(replayed(list(logs))), [replayed([one])() for one in logs]
        pooled = read_result(folder / f"{'-'.join(logs)}.out.mcap")
        tracks = {
            one: part.fixes[:: len(part.fixes) // 200 + 1] for one, part in pooled.vehicles.items()
        }
        single = {one: read_result(folder / f"{one}.out.mcap") for one in logs}
        others = dict(zip(logs, ("sg2", "sg1", "sg4", "sg3"), strict=True))
        error = {
            "pooled": _error(truth, [(pooled, track) for track in tracks.values()]),
            "alone": _error(truth, [(single[one], tracks[one]) for one in logs]),
            "alone_about_the_other": _error(
                truth, [(single[one], tracks[others[one]]) for one in logs]
            ),
        }
        size = f"{strip.columns * strip.rows} points, {len(pooled.estimates)} windows of {strip.window}"
        return found | row(
            f"4 gliders in pairs far apart, {pings // 144} days of mean currents, {size}",
            found["ours_s"],
            "each alone",
            error=error,
            peak_mb=found["peak_mb"],
            alone_s=sum(one["ours_s"] for one in singles),
        )


def _error(truth: Ensemble, tracks: Iterable[tuple[Result, pd.DataFrame]]) -> float:
    """Return the RMS of the error of estimates at places of tracks that they know [m/s], a component."""
    squares, levels = list[Array](), LEVELS[None, :-1]
    for result, track in tracks:
        at = [track[axis].to_numpy()[:, None] for axis in ("longitude", "latitude")]
        found, place = result.velocity_at(*at, levels), to_local(truth.grid.projection, *at)
        true = build_field(truth).velocity(*place, levels)
        u, v = rotate_to_geographic(truth.grid.projection, *at, true[..., 0], true[..., 1])
        squares += [(found.u - u) ** 2, (found.v - v) ** 2]
    return float(np.sqrt(np.nanmean(np.concatenate(squares))))


def _read(path: Path) -> Ensemble:
    return read_ensemble(path, ForecastConfig())
