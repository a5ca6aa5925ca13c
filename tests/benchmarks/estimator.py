"""The estimator at the paper's size against the textbook: 31 x 17 x 8 points, 95 members, 300 modes, 22 bins of 32 m."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from replay_kit.config.run import EstimatorConfig
from replay_kit.core.observation import Observation
from replay_kit.estimator import ReducedBasisEstimator, build
from tests.benchmarks import scene
from tests.benchmarks.measure import Row, cpu, peak_mb, row, runner
from tests.reference.dense import Near, Twin

# Rows, columns, levels, members; pings; of these so many in the textbook's way.
_SIZE, _PINGS, _FEW = (17, 31, 8, 95), 450, 3


def online(
    estimator: ReducedBasisEstimator, observations: Sequence[Observation]
) -> tuple[Any, list[Any]]:
    """Return the state after observations in blocks, as a replay takes them, and their innovations."""
    state, said, size = estimator.initial(), [], estimator.block_size
    for start in range(0, len(observations), size):
        state, steps = estimator.assimilate(state, observations[start : start + size])
        said += [step.innovation for step in steps]
    return state, said


def alone_ms(
    estimator: ReducedBasisEstimator, state: Any, observations: Sequence[Observation]
) -> float:
    """Return the median processor time of a ping that waits for no others [ms]."""
    times = []
    for observation in observations:
        took, (state, _) = cpu(lambda: estimator.assimilate(state, [observation]))  # noqa: B023
        times.append(took)
    return 1e3 * float(np.median(times))


def textbook(mean, cov, design, value, noise: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the update of a full covariance."""
    cov_design = cov @ design.T
    gain = np.linalg.solve(design @ cov_design + noise, cov_design.T).T
    return mean + gain @ (value - design @ mean), cov - gain @ cov_design.T


def relative(ours, theirs) -> float:
    """Return the length of a difference over that of what is right."""
    return float(np.linalg.norm(ours - theirs) / np.linalg.norm(theirs))


def update_row(
    estimator: ReducedBasisEstimator, observations: Sequence[Observation], where: str, asked: float
) -> Row:
    """All pings, the mean after each; the textbook over the first of them, multiplied."""
    few = observations[:_FEW]
    early, said = online(estimator, few)
    assert {one.error_inflation for one in said} == {1.0}
    # what members left out show is computed once, whatever the log
    evidence = estimator.evidence
    assert evidence is not None
    once, _ = cpu(lambda: (evidence.expected, evidence.kernels))
    before = peak_mb(anew=True)
    took, (state, _) = cpu(lambda: online(estimator, observations))
    grown = peak_mb() - before
    twin, size = Twin(estimator.flow(estimator.initial())), estimator.unknowns
    mean, cov, times, near = np.zeros(size), np.eye(size), [], Near(twin)
    for observation in few:
        (rows,) = near.rows(observation)
        spent, (mean, cov) = cpu(lambda: textbook(mean, cov, *rows))  # noqa: B023
        times.append(spent)
    return row(
        f"{len(observations)} pings {where}, hybrid prior, mean after each",
        took,
        f"textbook update of the full covariance, {len(rows[1])} rows a ping, {_FEW} pings timed and multiplied",
        float(np.median(times)) * len(observations),
        asked,
        {
            f"mean_after_{_FEW}": relative(early.x, mean),
            f"covariance_after_{_FEW}": relative(early.covariance, cov),
        },
        state=size,
        ms_a_ping=1e3 * took / len(observations),
        calibration_s=once,
        ms_a_ping_alone=alone_ms(estimator, state, observations[:10]),
        peak_mb=grown,
    )


def rows(tiny: bool) -> list[Row]:
    """Both rows, each in a process of its own; tiny ones in this one."""
    members, truth = scene.withheld(*((5, 6, 3, 6) if tiny else _SIZE))
    pings, run = 20 if tiny else _PINGS, runner(tiny)
    settings = EstimatorConfig(modes=300, mean_variance=0.1)
    estimator = build([members], settings)
    made = {
        ("along a track", 50.0): scene.track(pings),
        ("scattered", 30.0): scene.scattered(members.grid, pings),
    }
    return [
        run(lambda: update_row(estimator, scene.pings(truth, places), *what))  # noqa: B023
        for what, places in made.items()
    ]
