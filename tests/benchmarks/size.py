"""How set-up, a ping and a standard error grow with the region: processor time, and memory in a process of its own."""

import numpy as np

from replay_kit.config.run import EstimatorConfig
from replay_kit.core.flow.dataset import to_dataset
from replay_kit.estimator import build
from tests.benchmarks import scene
from tests.benchmarks.estimator import online
from tests.benchmarks.measure import Row, cpu, peak_mb, row, runner

# Rows, columns, levels, members, modes; asked [s] and [MB], None where nothing is.
_SIZES = (
    (17, 31, 8, 50, 300, 3.0, None),
    *(
        (side, side, 8, 50, 300, asked, None)
        for side, asked in ((30, None), (60, 6.0), (240, None))
    ),
    (120, 120, 30, 50, 300, 30.0, 1500.0),
)
_TINY = ((4, 4, 3, 5, 8, 1.0, None), (6, 6, 3, 5, 8, 1.0, None))


def size_row(*size: int, modes: int, asked: float | None, asked_mb: float | None) -> Row:
    """Return the set-up, and what memory grew to at most, the ensemble included."""
    before = peak_mb(anew=True)
    world = scene.ensemble(*size)
    took, estimator = cpu(lambda: build([world], EstimatorConfig(modes=modes)))
    words = "set-up, {} x {} nodes, {} levels, {} members".format(*size)
    name, grown = f"{words}, {estimator.unknowns} unknowns", peak_mb() - before
    return row(name, took, asked=asked or 0.0, peak_mb=grown, asked_mb=asked_mb)


def use_row(*size: int, pings: int, modes: int) -> Row:
    """Pings along a glider's track through the last member, the mean after each; then the standard error at every node and level."""
    world, truth = scene.withheld(*size)
    estimator = build([world], EstimatorConfig(modes=modes))
    took, (state, _) = cpu(lambda: online(estimator, scene.pings(truth, scene.track(pings))))
    before = peak_mb(anew=True)
    error_s, _ = cpu(lambda: to_dataset(estimator.flow(state)))
    more = {"ms_a_ping": 1e3 * took / pings, "asked_ms": 60.0}
    more |= {"standard_error_s": error_s, "asked_standard_error_s": 5.0}
    what = "{} x {} x {}, mean after each; standard error of every node and level".format(*size)
    more["peak_mb"] = peak_mb() - before
    return row(f"{pings} pings at {what}", took, asked=0.06 * pings, **more)


def rows(tiny: bool) -> list[Row]:
    """All rows, each in a process of its own, and the exponent of time and memory in the number of nodes; tiny ones in this one."""
    run, made = runner(tiny), list[Row]()
    for *size, modes, asked, most in _TINY if tiny else _SIZES:
        made.append(run(lambda: size_row(*size, modes=modes, asked=asked, asked_mb=most)))  # noqa: B023
    nodes = np.log([rows * columns for rows, columns, levels, *_ in _SIZES if levels == 8])
    for what in ("ours_s", "peak_mb") if not tiny else ():
        logs = np.log([one[what] for one in made[: nodes.size]])
        made[nodes.size - 1][f"exponent_of_{what}"] = float(np.polyfit(nodes, logs, 1)[0])
    use, pings = ((5, 6, 12, 6), 3) if tiny else ((120, 120, 30, 50), 200)
    return [*made, run(lambda: use_row(*use, pings=pings, modes=10 if tiny else 300))]
