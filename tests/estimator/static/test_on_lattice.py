"""Estimates of the default preset on its lattice against those of the dense kernel of all nodes."""

import numpy as np

from replay_kit.config.run import EstimatorConfig
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.flow.functions import NodeKernel
from replay_kit.core.flow.lattice import StreamFunctionLattice
from replay_kit.core.grid import Ensemble
from replay_kit.estimator import build_estimator
from replay_kit.estimator.basis import modes
from tests import synthetic
from tests.estimator.runs import after

WORLD = synthetic.ensemble(n_members=8, shape=(9, 11), levels=np.array([5.0, 90.0, 220.0]))
OBSERVATIONS = synthetic.random_profiles(WORLD.grid, 6)


def estimated(ensemble: Ensemble) -> tuple[FlowEstimate, FlowEstimate]:
    """Return the prior's flow and that after all observations."""
    estimator = build_estimator(ensemble, EstimatorConfig(sample_share=0.5, spread=1.0))
    return estimator.flow(estimator.initial()), estimator.flow(after(estimator, OBSERVATIONS))


def test_increments_and_standard_errors_off_the_nodes_are_those_of_the_dense_kernel(
    monkeypatch,
):
    lattice = estimated(WORLD)
    on_lattice = modes.default_functions

    def dense(grid, config, speed=1.0):
        return NodeKernel(on_lattice(grid, config, speed).kernel, grid.nodes)

    monkeypatch.setattr(modes, "default_functions", dense)
    nodes = estimated(WORLD)
    assert isinstance(lattice[0].horizontal, StreamFunctionLattice)
    assert isinstance(nodes[0].horizontal, NodeKernel)
    rng, (east, north) = np.random.default_rng(0), WORLD.grid.nodes.T
    places = (
        rng.uniform(east.min(), east.max(), 100),
        rng.uniform(north.min(), north.max(), 100),
        rng.uniform(0.0, 220.0, 100),
    )
    ours, theirs = (
        then.velocity(*places) - before.velocity(*places) for before, then in (lattice, nodes)
    )
    assert np.linalg.norm(ours - theirs) < 1e-3 * np.linalg.norm(theirs)
    ours, theirs = (then.standard_error(*places) for _, then in (lattice, nodes))
    np.testing.assert_allclose(ours, theirs, rtol=1e-3)
