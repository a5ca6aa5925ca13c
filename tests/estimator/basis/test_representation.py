"""The representation error: of shifted copies, node by node, and where it is used."""

from dataclasses import replace

import numpy as np
import pytest

from replay_kit.config.run import EstimatorConfig
from replay_kit.estimator import build
from replay_kit.estimator.basis.shifts import shifted_residual
from replay_kit.estimator.basis.slices import correlation_length, ensemble_slices
from tests import synthetic

SMALL = synthetic.ensemble(n_members=5, shape=(4, 5), levels=np.array([5.0, 90.0, 220.0]))
NODES = SMALL.grid.nodes


def slow_residual(fields, modes, nodes, shift):
    """Each copy fitted by least squares, node by node the nearest one to the shifted place."""
    square, copies = 0.0, 0
    for field in fields:
        for step in ([shift, 0.0], [-shift, 0.0], [0.0, shift], [0.0, -shift]):
            nearest = [int(np.argmin(np.hypot(*(nodes - (node + step)).T))) for node in nodes]
            halves = np.split(field, 2, axis=1)
            copy = np.concatenate([half[:, nearest] for half in halves], axis=1)
            left = copy.T - modes @ np.linalg.lstsq(modes, copy.T, rcond=None)[0]
            square, copies = square + left.T**2, copies + 1
    return np.sqrt(0.5 * (square[:, : len(nodes)] + square[:, len(nodes) :]) / copies)


def test_it_is_what_least_squares_leaves_of_shifted_copies():
    slices = ensemble_slices(SMALL)
    mean, modes = slices.mean(axis=0), np.random.default_rng(0).standard_normal((2 * len(NODES), 7))
    found = shifted_residual([SMALL], mean, modes, 1.2e4)
    np.testing.assert_allclose(found, slow_residual(slices - mean, modes, NODES, 1.2e4), rtol=1e-9)


@pytest.mark.parametrize("stated", [None, 0.07])
def test_an_estimate_errs_by_what_the_basis_leaves_at_each_place(stated):
    config = EstimatorConfig(modes=6, representation_error_std=stated, dropped_std=0.0)
    estimator = build([SMALL], config)
    basis = estimator.observer.basis
    modes = basis.horizontal.velocity(NODES, basis.modes).reshape(2 * len(NODES), -1)
    mean = ensemble_slices(SMALL).mean(axis=0)
    expected = shifted_residual([SMALL], mean, modes, correlation_length(SMALL))
    flow = estimator.flow(estimator.initial())
    error = flow.unknowns.error
    # nothing else is uncertain: beside a node the error is that of the nearest one
    sure = replace(flow, unknowns=replace(flow.unknowns, p=0.0 * flow.unknowns.p))
    found = sure.standard_error(*(0.999 * NODES).T, flow.levels[:, None])
    np.testing.assert_allclose(found, np.stack([error, error], axis=2))
    np.testing.assert_allclose(error, expected if stated is None else stated, rtol=1e-9)
