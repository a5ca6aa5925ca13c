"""The estimator at the paper's size against the slow ways: 31 x 17 x 8 points, 95 members, all modes, 22 bins of 32 m.

The default preset takes the paper's kernel length here: the last modes of the full rank are finer than its own of two cells can show, and
their weights are quotients of small numbers. Its modes are 752, not 760: the mean is kept apart.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from replay_kit.config.run import EstimatorConfig
from replay_kit.core.flow.functions import depth_weights
from replay_kit.core.observation import Observation
from replay_kit.estimator import ReducedBasisEstimator, build
from replay_kit.estimator.basis.modes import build_basis
from replay_kit.estimator.basis.slices import ensemble_slices
from tests.benchmarks import scene, slow
from tests.benchmarks.measure import Row, peak_mb, row, runner, seconds


@dataclass(frozen=True)
class Work:
    """What the rows have in common."""

    size: scene.Size
    pings: int
    tiny: bool

    @cached_property
    def world(self):
        return scene.ensemble(self.size)

    @cached_property
    def estimator(self) -> ReducedBasisEstimator:
        settings = EstimatorConfig(modes=None, length_horizontal=10_000.0, mean_variance=0.1)
        return build([self.world[0]], settings)

    @cached_property
    def track(self) -> list[Observation]:
        return scene.track(self.world[1], self.pings, self.size)

    @cached_property
    def scattered(self) -> list[Observation]:
        return scene.scattered(self.world[1], self.pings, self.size)


def online(estimator, observations, mean: bool = True):
    """The state after observations, their innovations, and the time of each with its mean: in blocks, as a replay does."""
    state, said, times = estimator.initial(), [], []
    for start in range(0, len(observations), ReducedBasisEstimator.block_size):
        block = observations[start : start + ReducedBasisEstimator.block_size]

        def steps(state=state, block=block):
            done = list(estimator.steps(state, block))
            if mean:
                _ = estimator.weights([after for after, _ in done])
            return done

        took, done = seconds(steps)
        state = done[-1][0]
        said += [innovation for _, innovation in done]
        times += [took / len(block)] * len(block)
    return state, said, times


def alone_ms(estimator, state, observations) -> float:
    """The median time of a ping that waits for no others, with its mean [ms]."""
    times = []
    for observation in observations:

        def step(state=state, observation=observation):
            after = estimator.step(state, observation)[0]
            _ = after.mean
            return after

        took, state = seconds(step)
        times.append(took)
    return 1e3 * float(np.median(times))


def relative(ours, theirs) -> float:
    return float(np.linalg.norm(ours - theirs) / np.linalg.norm(theirs))


def basis_row(work: Work) -> Row:
    config = EstimatorConfig(modes=None, preset="paper")
    ensemble = work.world[0]
    ours_s, basis = seconds(lambda: build_basis(ensemble, config), 3)
    slices = ensemble_slices(ensemble)
    depth_kernel = depth_weights(basis.depth_functions, ensemble.grid.levels, ensemble.grid.levels)

    def peer():
        latents = slow.dense_embedding(
            slices, basis.horizontal.kernel, ensemble.grid.nodes, depth_kernel
        )
        modes = np.linalg.svd(latents.reshape(-1, latents.shape[2]).T, full_matrices=False)[0]
        return latents, modes

    peer_s, (latents, _) = seconds(peer)
    error = {"latents_relative": relative(basis.member_weights @ basis.modes.T, latents)}
    return row(
        "basis from the ensemble",
        ours_s,
        "dense kernel, Cholesky of all unknowns",
        peer_s,
        12.0,
        error,
        unknowns=latents[0].size,
    )


def update_row(work: Work, where: str, asked: float) -> Row:
    """All pings, the mean after each; textbook over a few pings, multiplied; a batch solution for the error at the end."""
    estimator, observations = work.estimator, getattr(work, where)
    before = peak_mb(anew=True)
    state, said, times = online(estimator, observations)
    grown = peak_mb() - before
    few = 3 if work.tiny else 5
    mean, cov = estimator.prior.mean, estimator.prior.covariance()
    peer_times, early = [], estimator.initial()
    for observation, innovation in zip(observations[:few], said[:few], strict=True):
        design, value, error = slow.rows(estimator, observation)
        error = error * np.sqrt(innovation.error_inflation)
        took, (mean, cov) = seconds(
            lambda m=mean, c=cov, d=design, v=value, e=error: slow.textbook(m, c, d, v, e)
        )
        peer_times.append(took)
        early, _ = estimator.step(early, observation)
    errors = {f"mean_after_{few}": relative(early.mean, mean)}
    probes = np.random.default_rng(0).standard_normal((20, mean.size))
    errors[f"covariance_after_{few}"] = relative(_probed(early, probes), probes @ cov @ probes.T)
    del cov, early
    batch_mean, batch_cov = slow.batch(
        estimator, observations, [i.error_inflation for i in said], probes
    )
    errors["mean_at_end"] = relative(state.mean, batch_mean)
    if work.tiny or where == "track":  # the dense covariance of the dual form takes half a minute
        errors["covariance_at_end"] = relative(_probed(state, probes), batch_cov)
    n, rows = mean.size, 2 * work.size.bins
    peer_s = float(np.median(peer_times)) * len(observations)
    return row(
        f"{len(observations)} pings {where}, hybrid prior, mean after each",
        sum(times),
        f"textbook update of the full covariance, {rows} rows a ping, {few} pings timed and multiplied",
        peer_s,
        asked,
        errors,
        state=n,
        form=type(state.posterior).__name__,
        directions=getattr(state.posterior, "size", None),
        ms_a_ping=1e3 * sum(times) / len(times),
        ms_a_ping_alone=alone_ms(estimator, state, observations[:10]),
        read_gb_s=_bytes_read(estimator, state, len(observations)) / sum(times) / 1e9,
        peak_mb=grown,
    )


def _bytes_read(estimator: ReducedBasisEstimator, state, pings: int) -> float:
    """What the updates must read at least: the prior's parts twice a block, and L twice a block or M once a ping."""
    prior = sum(
        getattr(estimator.prior, name).nbytes
        for name in ("factor", "horizontal", "variance")
        if hasattr(estimator.prior, name)
    )
    posterior = state.posterior
    if hasattr(posterior, "matrix"):
        return pings * (
            2.0 * prior / ReducedBasisEstimator.block_size + posterior.matrix.nbytes / 2.0
        )
    return (
        pings / ReducedBasisEstimator.block_size * (2.0 * prior + 8.0 * posterior.n_rows**2 / 3.0)
    )


def _probed(state, probes):
    """The posterior covariance of some combinations of weights, shape (p, p)."""
    return probes @ state.posterior.covariance() @ probes.T


def grid_row(work: Work) -> Row:
    estimator, grid = work.estimator, work.world[0].grid
    state, _, _ = online(estimator, work.track, mean=False)
    flow = estimator.flow(state)
    covariance_s, _ = seconds(lambda: flow.unknowns.p)
    east, north = grid.nodes.T
    levels = grid.levels[:, None]

    def ours():
        return flow.velocity(east, north, levels), flow.standard_error(east, north, levels)

    ours_s, (velocity, error) = seconds(ours, 3)
    peer_s, (expected, std) = seconds(lambda: slow.grid_std(flow, grid.nodes))
    theirs = std.reshape(grid.levels.size, 2, -1).transpose(0, 2, 1)
    errors = {
        "standard_error_relative": relative(error, theirs),
        "velocity_relative": relative(
            velocity, expected.reshape(2, len(grid.nodes), -1).transpose(2, 1, 0)
        ),
    }
    name = "velocity and standard error on the whole grid, hybrid prior"
    return row(
        name,
        ours_s,
        "diag(H P H') with dense H",
        peer_s,
        20.0,
        errors,
        covariance_s=covariance_s,
        rows=theirs.size,
    )


def rows(tiny: bool) -> list[Row]:
    """All rows, each in a process of its own; tiny ones in this one."""
    work = Work(scene.TINY, 40, True) if tiny else Work(scene.Size(), 450, False)
    _ = work.estimator, work.track, work.scattered
    run = runner(tiny)
    done = [run(lambda: basis_row(work))]
    for where, times in {"track": 25.0, "scattered": 10.0}.items():
        done.append(run(lambda a=where, b=times: update_row(work, a, b)))
    return [*done, run(lambda: grid_row(work))]
