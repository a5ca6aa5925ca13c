"""Flows of random numbers, with all that an estimate may have."""

from dataclasses import replace

import numpy as np

from replay_kit.core.flow.functions import lattice_over
from replay_kit.core.flow.local import LocalCurrent, Oscillation, SurfaceCurrent
from replay_kit.core.flow.process import Process, Unknowns
from tests.synthetic_flow import TIME_NS, synthetic_flow

HOUR = 3600 * 10**9
LOCAL = LocalCurrent(
    probability=np.array([0.3, 0.5, 0.2]),
    std=np.array([0.0, 0.08, 0.16]),
    scale=np.array([6.0, 24.0, 96.0]) * 3600.0,
    mean=np.array([[0.0, 0.0], [0.06, -0.02], [0.1, 0.03]]),
    cov=np.array(
        [[[0.0, 0.0], [0.0, 0.0]], [[4e-4, 1e-4], [1e-4, 3e-4]], [[9e-4, 0.0], [0.0, 9e-4]]]
    ),
    time_ns=TIME_NS,
)

SURFACE = SurfaceCurrent(
    east=np.array([-9e3, 0.0, 9e3]),
    north=np.array([-5e3, 5e3]),
    velocity=np.linspace(-0.1, 0.2, 12).reshape(2, 3, 2),
    error=np.linspace(0.01, 0.06, 6).reshape(2, 3),
    std=0.08,
    depth=5.0,
    time_ns=TIME_NS,
)


def changing(
    n_moving=5,
    n_fixed=2,
    time_ns=TIME_NS,
    times=4,
    on_lattice=False,
    potential=True,
    turning=0,
    **of,
):
    """A flow of a random process with forecasts every six hours, two of them before the estimate's time; or with one, and constant."""
    rng, still = np.random.default_rng(4), synthetic_flow(n_modes=0, **of)
    levels, functions, modes, size = 3, 2, 4, n_moving + n_fixed
    horizontal = (
        lattice_over(still.horizontal.kernel, still.nodes) if on_lattice else still.horizontal
    )
    tau = 3600.0 * np.array([50.0] * n_moving + [10.0] * n_fixed)
    process = Process(
        (TIME_NS + HOUR * np.array([-8, -2, 4, 10]))[:times],
        rng.normal(size=(times, levels, modes)),
        rng.normal(size=(times, n_moving, functions, modes)),
        rng.normal(size=(n_fixed, functions, modes)),
        np.array([0.5, 1.0, 1.5, 2.5])[:times],
        np.linalg.qr(rng.normal(size=(levels, functions)))[0].T,
        tau if times > 1 else np.full(size, np.inf),
    )
    half = 0.2 * rng.normal(size=(size, size))
    error = rng.uniform(0.02, 0.1, (levels, len(still.nodes)))
    swinging = Oscillation(
        1e-4 * rng.normal(size=turning), *rng.normal(size=(2, turning, 2, 3)), 2e5, TIME_NS
    )
    made = rng.normal(size=(3, horizontal.size, max(levels, modes)))
    unknowns = Unknowns(
        process,
        made[0, :, :levels],
        rng.normal(size=size),
        half @ half.T,
        time_ns,
        error,
        1.7,
        swinging if turning else None,
    )
    flow = replace(
        still,
        horizontal=horizontal,
        latent=made[0, :, :levels],
        modes=made[1, :, :modes],
        unknowns=unknowns,
        potential=made[2, :, :levels] if potential else None,
    )
    return flow.moved(TIME_NS)
