"""More water in the estimate: what geostrophic shear adds, and whether its stated errors hold.

Lines of a glider go through members of a quasi-geostrophic forecast that are left out and change while it flies, and through a sea of the
primitive equations. Density is the stream function's vertical derivative, with internal waves of Garrett and Munk; what of the truth is not
geostrophic stays in it. The profile error is that of the current across the line about its depth mean where and when the glider was, and
at the end, with mean currents and with shear beside them.
"""

import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from unittest.mock import patch

import numpy as np

from replay_kit.config.estimation import GatingConfig
from replay_kit.config.run import EstimatorConfig, ForecastConfig, load_config
from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.observation import Label, Observation, Source
from replay_kit.estimator import build_estimator
from replay_kit.forecast import read_ensemble, read_truth
from replay_kit.logs import merge, open_logs
from replay_kit.measurements.interpret import events_of
from replay_kit.measurements.section.hydrography import Section
from replay_kit.measurements.section.lines import COMPLETE, LEAST, measurement
from replay_kit.measurements.section.thermal_wind import (
    GeostrophicShear,
    fitted_line,
    regime_of,
    window_shear,
)
from replay_kit.studies.twins.ensemble import write_ensemble
from replay_kit.workflows.replay.inputs.job import ReplayJob
from replay_kit.workflows.replay.replay import replay
from tests.benchmarks import kinds_surface
from tests.benchmarks.kinds_line import Line, Sea, flown, means, quasi_geostrophic, section
from tests.benchmarks.measure import Row, alone, cpu, row
from tests.logs.surface import made
from tests.places import DATA

_NS = 1e9
# m
_LENGTHS = (10e3, 20e3, 36e3, 50e3, 100e3)


def shears(sea: Sea, line: Line) -> Iterator[tuple[Section, GeostrophicShear, slice]]:
    """Yield the shear of each window of a line, with its section and profiles, as ``lines`` makes windows after each dive."""
    n, begun, before = line.along.size, 0, 0
    for end in range(4, n + 1):
        if end - begun < 4 or ((end - begun) % 2 and end < n):
            continue
        part = slice(begun, end)
        radius = regime_of(section(sea, line, part), sea.speed).rossby_radius
        if np.ptp(line.along[part]) < COMPLETE * radius and end < n:
            continue
        whole = section(sea, line, slice(before, end))
        numbers = np.arange(begun - before, end - before)
        yield whole, window_shear(fitted_line(whole, sea.speed), numbers), part
        before, begun = begun, end


def judged(line: Line, whole: Section, shear: GeostrophicShear, part: slice) -> dict[str, float]:
    """Return how a shear's error compares with what it states, at eight levels, at its place and the time of its last profile."""
    unit = np.array([np.cos(shear.direction), np.sin(shear.direction)])
    across = line.about_mean(line.current(line.seconds[part][-1]))[part] @ unit
    at = shear.along + line.along[part.stop - whole.along.size : part.stop].mean()
    truth = np.array([np.interp(at, line.along[part], column) for column in across.T])
    chosen = np.unique(np.linspace(0, line.levels.size - 1, 8).round().astype(int))
    error, cov = (shear.velocity - truth)[chosen], shear.covariance[np.ix_(chosen, chosen)]
    std = np.sqrt(np.diag(cov))
    return {
        "nis": float(error @ np.linalg.solve(cov, error)) / chosen.size,
        "held": float(np.mean(np.abs(error) < 1.645 * std)),
        "actual": float(np.mean(error**2)),
        "stated": float(np.mean(std**2)),
    }


def profile_errors(flow: FlowEstimate, line: Line) -> Array:
    """Return the mean squared errors [m2/s2] of a flow's profiles about their depth means, across the line, at its profiles.

    Shape (2,): at the time at which the glider was at each, and at the end of the line.
    """
    across = np.array([-np.sin(line.direction), np.cos(line.direction)])
    found = line.about_mean(flow.velocity(*line.places[::3].T[..., None], line.levels))
    truths = (line.current(seconds)[::3] for seconds in (line.seconds, line.seconds[-1]))
    return np.array([np.mean(((found - line.about_mean(one)) @ across) ** 2) for one in truths])


def shear_row(name: str, seas: Sequence[Sea], lines: int, length: float) -> Row:
    """Return the row of lines of a length, as many in each sea."""
    rng, began = np.random.default_rng(round(length)), time.process_time()
    errors, found, radius = [], [], 1.0
    for sea in seas:
        for _ in range(lines):
            line, state = flown(sea, length, rng), sea.estimator.initial()
            for mean in means(sea, line, rng):
                state, _ = sea.estimator.step(state, mean)
            alone = profile_errors(sea.estimator.flow(state), line)
            for whole, shear, part in shears(sea, line):
                radius = regime_of(whole, sea.speed).rossby_radius
                # of a shorter one nothing is stated
                if np.ptp(line.along[part]) >= LEAST * radius:
                    found.append(judged(line, whole, shear, part))
                    source = Source(0, "/ctd", 0, int(line.seconds[-1] * _NS))
                    given = measurement(shear, whole, Label(0, source, kind="shear"))
                    state, _ = sea.estimator.step(state, given)
            errors.append((alone, profile_errors(sea.estimator.flow(state), line)))
    alone, beside = np.sqrt(np.mean(errors, axis=0))
    mean = {key: float(np.mean([each[key] for each in found])) for key in found[0]}
    figures = {
        "profile error along the way [m/s], mean currents": float(alone[0]),
        "and shear": float(beside[0]),
        "ratio": float(beside[0] / alone[0]),
        "ratio at the end of the line": float(beside[1] / alone[1]),
        "within 90 %": mean["held"],
        "NIS": mean["nis"],
        "stated over actual": float(np.sqrt(mean["stated"] / mean["actual"])),
    }
    words = f"{length / 1e3:.0f} km ({length / radius:.1f} Rossby radii), {len(errors)} lines"
    return row(f"shear, {name}: {words}", time.process_time() - began, error=figures)


def month_row(days: int, n: int) -> Row:
    """A replay of hourly totals: processor time and memory."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        paths = folder / "ensemble.nc", folder / "truth.nc"
        write_ensemble(*paths)
        hours = np.arange(24 * days)
        turning = np.stack([f(2.0 * np.pi * hours / 12.42) for f in (np.cos, np.sin)])
        current = 0.1 * turning[..., None, None, None]
        whole = made.totals(current, len(hours), (n, n), 151.8, -40.4, 0.014)
        whole.to_netcdf(folder / "totals.nc", engine="h5netcdf")
        job = ReplayJob((folder / "totals.nc",), paths[0], folder / "out.mcap", overwrite=True)

        def work() -> Row:
            took, (summary, _) = cpu(lambda: replay(job, load_config(None)))
            used = next(iter(summary.sources)).used
            title = f"replay of {days} days of hourly totals, {n} x {n}"
            return row(
                title,
                took,
                asked_s=300.0,
                asked_mb=800.0,
                error={"unused": float(len(hours) - used)},
            )

        return alone(work)


def withheld_row(least: float) -> Row:
    """Five real dives whose ADCP is withheld: how well their profiles are known, with the CTD and without.

    Args:
        least: Shortest line that tells of the shear [Rossby radii].
    """
    began, paths = time.process_time(), tuple(sorted((DATA / "seaglider").glob("p17101*.nc")))
    events = events_of(merge(open_logs(paths), 1.0), load_config(None).measurements)
    seen = [each for some in events for each in some if isinstance(each, Observation)]
    figures: dict[str, float] = {}
    for name, without in (("mean currents", ["profiles", "shear"]), ("and CTD", ["profiles"])):
        own = {"forecast": {"place": True}, "measurements": {"without": without}}
        job = ReplayJob(paths, DATA / "qg" / "climatology.nc")
        with patch("replay_kit.measurements.section.lines.LEAST", least):
            summary, flow = replay(job, load_config(None, own))
        off = []
        for each in seen:
            found = flow.velocity_at(each.longitude, each.latitude, each.depth)
            error = np.column_stack([found.u, found.v]) - each.velocity
            error = error[np.isfinite(error).all(axis=1)]
            off.append(error - error.mean(axis=0))
        figures[f"profile error about the depth mean [m/s], {name}"] = float(
            np.sqrt(np.mean(np.concatenate(off) ** 2))
        )
        figures[f"shears, {name}"] = float(sum(each.used for each in summary.sources))
    title = f"Seaglider without its ADCP, lines of {least:g} Rossby radii and more"
    return row(title, time.process_time() - began, error=figures)


def primitive(lines: int) -> list[Row]:
    """Return the rows of the geostrophic part of a current of the primitive equations: what is not geostrophic is in the truth as error."""
    folder = DATA / "natl_nemo"
    ensemble, truth = (
        read_ensemble(folder / "ensemble.nc", ForecastConfig()),
        read_truth(str(folder / "truth.nc"), ForecastConfig()),
    )
    estimator = build_estimator(ensemble, EstimatorConfig(), GatingConfig())
    sea = Sea(ensemble, estimator, truth.velocity, np.zeros(1))
    return [shear_row("natl_nemo", [sea], lines, length) for length in _LENGTHS]


def rows(tiny: bool) -> list[Row]:
    """Return what was measured."""
    surface = [*kinds_surface.rows(tiny), month_row(*((1, 12) if tiny else (30, 100)))]
    if not (DATA / "qg").exists():
        return surface
    if tiny:
        return [shear_row("qg", quasi_geostrophic((7,), True), 1, _LENGTHS[2]), *surface]
    seas = {
        "qg, prior of a climatology": quasi_geostrophic((1, 7, 25), True),
        "qg, prior of a forecast of 8 days": quasi_geostrophic((1, 7, 25), False),
    }
    shear = [
        shear_row(name, of_name, 16, length)
        for name, of_name in seas.items()
        for length in _LENGTHS
    ]
    return [*shear, *primitive(48), withheld_row(LEAST), withheld_row(0.0), *surface]
