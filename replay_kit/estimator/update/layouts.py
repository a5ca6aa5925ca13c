"""How values see the column of water at their place; measurements of equal depths and errors see it alike.

Whitened by W, W N W' = 1, and compressed by W J = Q R, Q orthonormal, the values are the rows R a of unit noise (``columns.py``). Those of
many measurements are found together.
"""

from collections import defaultdict
from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dtrtri

from replay_kit.core.arrays import Array
from replay_kit.core.observation import LinearMeasurement

# Share of the largest singular value of W J below which one is rounding.
_ROUNDING = 1e-10


@dataclass(frozen=True, slots=True, eq=False)
class Layout:
    """How the used values of a measurement see their column; alike for measurements of equal depths and errors.

    Attributes:
        levels: shape (m, Z), functions of the levels at the values' depths; (m, 0) of sums over several places.
        functions: shape (m, K), J, of one component.
        whiten: shape (w, m), W.
        q: shape (w, p), Q.
        r: shape (p, K), R.
        std: shape (m,) [m/s], error of each value with the representation's.
        half_log_det: Of N.
        unwhiten: shape (m, w), of values that are known up to a constant; None of others.
    """

    levels: Array
    functions: Array
    whiten: Array
    q: Array
    r: Array
    std: Array
    half_log_det: float
    unwhiten: Array | None = None

    def known(self, values: Array) -> Array:
        """Return what is known of values, shape (..., m, n): of relative ones all but a constant."""
        return values if self.unwhiten is None else self.unwhiten @ (self.whiten @ values)


class Sight(NamedTuple):
    """What a layout is made of.

    Attributes:
        levels: shape (m, Z), as of ``Layout``.
        functions: shape (m, K), J.
        covariance: shape (m, m) [m^2/s^2], N, without the shared error where that is infinite.
        is_relative: Whether it is infinite.
    """

    levels: Array
    functions: Array
    covariance: Array
    is_relative: bool


def layouts_of(sights: Sequence[Sight]) -> list[Layout]:
    """Return the layouts of sights, those with as many values together.

    Raises:
        numpy.linalg.LinAlgError: A covariance is not positive definite.
    """
    alike = defaultdict[Hashable, list[int]](list)
    for i, sight in enumerate(sights):
        alike[sight.functions.shape, sight.is_relative].append(i)
    found = dict[int, Layout]()
    for numbers in alike.values():
        found |= zip(numbers, _of_equal_size([sights[i] for i in numbers]), strict=True)
    return [found[i] for i in range(len(sights))]


def _of_equal_size(sights: Sequence[Sight]) -> list[Layout]:
    covariance = np.stack([sight.covariance for sight in sights])
    functions = np.stack([sight.functions for sight in sights])
    lower = np.asarray(np.linalg.cholesky(covariance))
    whiten = np.array([dtrtri(each, lower=1)[0] for each in lower])
    std = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    half_log_det = np.log(np.diagonal(lower, axis1=1, axis2=2)).sum(axis=1)
    unwhiten = None
    if sights[0].is_relative:
        ones = whiten.sum(axis=2)
        half_log_det = half_log_det + 0.5 * np.log(np.sum(ones**2, axis=1))
        complement = np.linalg.qr(ones[..., None], mode="complete")[0][..., 1:]
        whiten, unwhiten = complement.swapaxes(1, 2) @ whiten, lower @ complement
        std = np.sqrt(np.sum(unwhiten**2, axis=2))
    # functions may depend on each other, as levels' do on the constant: no row may be made of rounding
    q, size, along = np.linalg.svd(whiten @ functions, full_matrices=False)
    kept = size > _ROUNDING * size.max(axis=1, keepdims=True, initial=0.0)
    return [
        Layout(
            sight.levels,
            sight.functions,
            whiten[i],
            q[i][:, own],
            size[i, own, None] * along[i, own],
            std[i],
            float(half_log_det[i]),
            None if unwhiten is None else unwhiten[i],
        )
        for i, (sight, own) in enumerate(zip(sights, kept, strict=True))
    ]


def layout_key(linear: LinearMeasurement, used: NDArray[np.bool_]) -> Hashable:
    """Return what alike measurements share."""
    arrays = linear.depth, linear.weights, linear.error_std, linear.correlation, used
    parts = (None if each is None else each.tobytes() for each in arrays)
    return linear.common_std, linear.correlation_depth, *parts
