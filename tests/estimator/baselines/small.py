"""One small ensemble, profiles of it, and its members interpolated by the slow twin: shared by the tests of the baselines."""

import numpy as np

from replay_kit.config.run import EstimatorConfig
from replay_kit.estimator.basis.modes import default_functions
from replay_kit.estimator.basis.slices import ensemble_slices
from tests import synthetic
from tests.reference import baselines as slow
from tests.reference import lattice

SMALL = synthetic.ensemble(n_members=5, shape=(4, 5), levels=np.array([5.0, 90.0, 220.0]))
GRID = SMALL.grid
MEMBERS = ensemble_slices(SMALL)
# a nugget so small that a flow at the nodes is what it was made of, to the tolerances below
CONFIG = EstimatorConfig(nugget=1e-9)
DEPTHS = np.array([20.0, 100.0, 200.0])
STD = 0.05


def profiles(n, seed=0):
    """Profiles of three bins, their places, and their local values."""
    rng = np.random.default_rng(seed)
    out, places, values = [], [], []
    for k in range(n):
        place = rng.uniform(-1.2e4, 1.2e4, 2)
        value = 0.2 * rng.standard_normal((DEPTHS.size, 2))
        out.append(synthetic.profile(GRID, *place, DEPTHS, value, STD, time_ns=k + 1))
        places.append(place)
        values.append(value)
    return out, places, values


def at_nodes(flow):
    """Velocity at all nodes and levels, shape (Z, 2N)."""
    return _at_nodes(flow.velocity)


def std_at_nodes(flow):
    return _at_nodes(flow.standard_error)


def _at_nodes(function):
    both = function(*GRID.nodes.T, GRID.levels[:, None])
    return np.moveaxis(both, -1, 1).reshape(GRID.levels.size, -1)


def from_nodes(place):
    """The matrix from velocities at the nodes to that at a place."""
    return lattice.interpolation(default_functions(GRID, CONFIG), GRID.nodes, place, CONFIG.nugget)


def members_at(place):
    return slow.design_of_members(MEMBERS, GRID.levels, from_nodes(place), DEPTHS)
