"""How the estimator's wall time and memory grow with pings, modes, grid and members: fitted exponents, and a figure."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from replay_kit.config.run import EstimatorConfig
from replay_kit.estimator import build_estimator
from replay_kit.estimator.basis.modes import build_basis
from tests.benchmarks import scene
from tests.benchmarks.estimator import online
from tests.benchmarks.measure import alone, peak_mb, seconds

Series = dict[str, Any]


def curves(tiny: bool) -> list[Series]:
    """Return each curve: what was varied, its values, wall times [s], memory [MB], and the exponent of the last half of the times."""
    size = scene.TINY if tiny else scene.Size()
    ensemble, truth = scene.ensemble(size)
    pings = (8, 16) if tiny else (50, 200, 800, 3200, 20_000)
    modes = (4, 8) if tiny else (95, 190, 380, 760)
    grids = ((5, 6), (6, 8)) if tiny else ((17, 31), (24, 44), (34, 62))
    members = (4, 8) if tiny else (24, 48, 96, 192, 384)
    few = 10 if tiny else 95
    paper = build_estimator(ensemble, EstimatorConfig(preset="paper", modes=few))
    survey = scene.survey(truth, pings[-1], size)
    some = scene.scattered(truth, 6 if tiny else 100, size)
    full = {
        m: build_estimator(ensemble, EstimatorConfig(modes=m, length_horizontal=10_000.0))
        for m in modes
    }

    def basis_of(**changed: int) -> Callable[[], Any]:
        other = scene.ensemble(scene.Size(**(size.__dict__ | changed)))[0]
        return lambda: build_basis(other, EstimatorConfig(preset="paper", modes=None))

    return [
        _curve(
            f"pings of a survey, {few} modes, paper prior",
            pings,
            lambda n: lambda: online(paper, survey[:n]),
            tiny,
        ),
        _curve(
            f"modes, {len(some)} scattered pings, hybrid prior",
            modes,
            lambda m: lambda: online(full[m], some),
            tiny,
        ),
        _curve(
            "grid points a level, basis",
            tuple(j * i for j, i in grids),
            _by(grids, lambda g: basis_of(rows=g[0], columns=g[1])),
            tiny,
        ),
        _curve("members, basis", members, lambda n: basis_of(members=n), tiny),
    ]


def _by(
    grids: tuple[tuple[int, int], ...], work: Callable[[tuple[int, int]], Callable[[], Any]]
) -> Callable[[int], Callable[[], Any]]:
    of_points = {j * i: (j, i) for j, i in grids}
    return lambda points: work(of_points[points])


def _curve(
    name: str, values: tuple[int, ...], work: Callable[[int], Callable[[], Any]], tiny: bool
) -> Series:
    def one(value: int) -> dict[str, Any]:
        job = work(value)
        before = peak_mb(anew=True)
        return {"seconds": seconds(job)[0], "peak_mb": peak_mb() - before}

    points = [one(value) if tiny else alone(lambda value=value: one(value)) for value in values]
    times, memory = [p["seconds"] for p in points], [p["peak_mb"] for p in points]
    return {"name": name, "values": list(values), "seconds": times, "peak_mb": memory} | {
        "exponent_of_time": _exponent(values, times),
        "exponent_of_memory": _exponent(values, memory) if min(memory) > 0.0 else None,
    }


def _exponent(values: tuple[int, ...], results: list[float]) -> float:
    """Slope of the last half on logarithmic axes: the first half is overhead."""
    start = min(len(values) // 2, len(values) - 2)
    return float(np.polyfit(np.log(values[start:]), np.log(results[start:]), 1)[0])


def draw(series: list[Series], path: Path) -> None:
    """Write the curves beside a file, as PNG and SVG."""
    figure = Figure(figsize=(4.0 * len(series), 3.4), layout="constrained")
    for panel, curve in zip(figure.subplots(1, len(series)), series, strict=True):
        panel.loglog(
            curve["values"],
            curve["seconds"],
            "o-",
            label=f"seconds, exponent {curve['exponent_of_time']:.2f}",
        )
        if min(curve["peak_mb"]) > 0.0:
            panel.loglog(
                curve["values"],
                curve["peak_mb"],
                "s--",
                label=f"MB, exponent {curve['exponent_of_memory']:.2f}",
            )
        panel.set(xlabel=curve["name"], ylabel="wall time [s], peak memory [MB]")
        # the values measured, since a decade holds few of a logarithmic axis's own ticks and their labels overlap
        panel.set_xticks(curve["values"], [str(value) for value in curve["values"]])
        panel.set_xticks([], minor=True)
        panel.legend(fontsize=8)
    for suffix in (".png", ".svg"):
        figure.savefig(path.with_suffix(suffix), dpi=110)
