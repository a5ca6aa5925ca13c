import numpy as np
import pytest

from replay_kit.core.flow.horizontal import HorizontalKernel, velocity_kernel
from tests.reference.estimator import kernel_3d

KERNEL = HorizontalKernel(9_000.0, 11_000.0, 0.2)
RNG = np.random.default_rng(3)
POINTS, NODES = RNG.uniform(-3e4, 3e4, (7, 2)), RNG.uniform(-3e4, 3e4, (5, 2))


def stream_function_kernel(kernel, points, nodes):
    """psi(x) = sum_j k(x, x_j) (dy beta_u,j / ly^2 - dx beta_v,j / lx^2): shape (P, 2N), from latent velocities at the nodes to points."""
    dx, dy = points[:, None, 0] - nodes[:, 0], points[:, None, 1] - nodes[:, 1]
    lx, ly = kernel.length_east, kernel.length_north
    k = (kernel.speed * lx) ** 2 * np.exp(-0.5 * ((dx / lx) ** 2 + (dy / ly) ** 2))
    return np.hstack([k * dy / ly**2, -k * dx / lx**2])


def test_equals_the_block_written_out():
    ours = velocity_kernel(KERNEL, POINTS, NODES)
    for i, point in enumerate(POINTS):
        for j, node in enumerate(NODES):
            block = kernel_3d((*point, 0.0), (*node, 0.0), (9_000.0, 11_000.0, 1.0), 0.2)
            np.testing.assert_allclose(
                ours[np.ix_([i, 7 + i], [j, 5 + j])], block, rtol=1e-12, atol=1e-16
            )


def test_is_speed_squared_at_zero_distance_when_lengths_agree():
    at_itself = velocity_kernel(HorizontalKernel(8e3, 8e3, 0.3), POINTS[:1], POINTS[:1])
    np.testing.assert_allclose(at_itself, 0.09 * np.eye(2), rtol=1e-12)


def test_is_symmetric_and_positive_semidefinite():
    kernel = velocity_kernel(KERNEL, NODES, NODES)
    np.testing.assert_array_equal(kernel, kernel.T)
    assert np.linalg.eigvalsh(kernel).min() > 0.0


@pytest.mark.parametrize("column", range(10))
def test_velocity_is_the_rotated_gradient_of_the_stream_function(column):
    step = 1.0

    def psi(points):
        return stream_function_kernel(KERNEL, points, NODES)[:, column]

    u = (psi(POINTS + np.array([0, step])) - psi(POINTS - np.array([0, step]))) / (2 * step)
    v = -(psi(POINTS + np.array([step, 0])) - psi(POINTS - np.array([step, 0]))) / (2 * step)
    ours = velocity_kernel(KERNEL, POINTS, NODES)[:, column]
    np.testing.assert_allclose(ours, np.concatenate([u, v]), atol=1e-8 * np.abs(ours).max() + 1e-10)
