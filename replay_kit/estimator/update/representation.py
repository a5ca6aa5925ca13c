"""The choice of the posterior's representation: the cheaper one from here on.

Every form is exact. The observation-space form starts without any cost but works on all rows measured; the reduced-subspace form works on
their directions, which along a track are fewer than the rows. When the rows outnumber the weights and span nearly all directions, the
posterior becomes a full-covariance prior of an observation-space posterior without rows, again after every few profiles: memory and
time for each profile are then bounded. With thousands of weights the matrix itself is the larger burden, seconds to make and to change:
there the posterior stays in factors, in all directions if need be.

    representation        what is kept                                           work for each ping     memory
    observation space     the K rows so far, their Cholesky factor L             L read twice, P0 G'    K^2 / 2
    reduced subspace      the s directions of all G measured, M of Z s rows      M times rows, P0 G'    (Z s)^2, s <= r

Directions are counted at 32, 64, 128 ... profiles; two for each profile is the most, and a glider's track has about half a direction for
each after 450. The covariance of all weights is computed when ``FlowEstimate.weight_cov`` is first read, as is the mean.

Products with P0, L and M for one ping cost reading them: 80 MB of parts of a hybrid prior at full rank, and more of L. A profile's
products do not depend on the values measured before it, so ``steps`` computes them for sixteen coming profiles at once
(``PriorCrossCovariance``), and ``means`` those of neighbouring states together. Single steps give the same result to rounding.

A direction is measured in prior standard deviations of the weights, because in the ``paper`` preset weights differ by 1e6, and a share of
1e-10 of G is not a share of 1e-10 of a velocity. The tolerance, 5e-11 of G, leaves the mean right to 1e-8 (to 4e-8 after thousands of pings
within a few hundred metres) and lies above what rounding leaves in G with all modes of a smooth kernel; far below it every ping would add a
direction of noise.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import takewhile

import numpy as np
import scipy.linalg
from scipy.linalg import solve_triangular

from replay_kit.core.arrays import Array, replace
from replay_kit.core.flow.covariance import Levels, Reduction, symmetric
from replay_kit.core.flow.factors import CovarianceFactors, half_size, n_stored
from replay_kit.estimator.prior.amplitude import ScaledPrior, hybrid_parts
from replay_kit.estimator.prior.conditioned import (
    ConditionedPrior,
    FullCovariancePrior,
    as_conditioned,
    full_covariance_prior,
    is_matrix,
    one_matrix,
)
from replay_kit.estimator.prior.hybrid import Prior
from replay_kit.estimator.update.observation_space import ObservationSpacePosterior, initial
from replay_kit.estimator.update.posterior import (
    Posterior,
    PriorCrossCovariance,
    directions,
    nonzero_mode_std,
)
from replay_kit.estimator.update.posterior import directions as orthonormal
from replay_kit.estimator.update.reduced_subspace import (
    ReducedSubspacePosterior,
    to_reduced_subspace,
)
from replay_kit.estimator.update.rows import PathRows, PredictedObservation, Rows

# Directions for each profile below which the reduced-subspace form is cheaper; at scattered places there are two.
_FEW = 1.25
# Rows for each weight above which the observation-space form is dearer wherever the profiles lie.
_MANY = 1.25
# The first number of profiles at which directions are counted; then at every doubling.
_FIRST = 32
# Share of all directions above which the reduced-subspace form is dearer than the full covariance.
_NEARLY_ALL = 0.75
# Rows that an observation-space posterior with a full-covariance prior holds before they are merged into that prior.
_MERGE_ROWS = 1024
# Rows for each weight up to which a mean along a path leaves the prior in parts: reading more of them takes longer than reading the matrix.
_FEW_ROWS = 0.25
# Rows of means along paths that wait until they are taken from one matrix together: it is copied and changed once for all.
_WAITING_ROWS = 32
# Weights above which no matrix of all of them is made; with 6,000 and all directions measured the matrix takes a third of the time a ping.
_LARGE = 7000


def select_representation(posterior: Posterior) -> Posterior:
    """Return the same posterior in the form that is cheaper from here on; a change costs as much as some dozens of updates."""
    large = posterior.n_weights > _LARGE
    if isinstance(posterior, ReducedSubspacePosterior):
        return (
            to_full_covariance(posterior)
            if not large and posterior.size > _NEARLY_ALL * posterior.mode_std.size
            else posterior
        )
    assert isinstance(posterior, ObservationSpacePosterior)
    if is_matrix(posterior.prior):
        return to_full_covariance(posterior) if posterior.n_rows > _MERGE_ROWS else posterior
    n, many = posterior.n, posterior.n_rows > _MANY * posterior.n_weights
    # powers of two, because counting costs about as much as an update
    if not many and (n < _FIRST or n & (n - 1)):
        return posterior
    mode_std = nonzero_mode_std(posterior.prior)
    found = directions(posterior.profile_basis * mode_std)
    if len(found) <= min(_FEW * n, _NEARLY_ALL * mode_std.size) or (many and large):
        return to_reduced_subspace(posterior, found, mode_std)
    return to_full_covariance(posterior) if many else posterior


def full_covariance_of(posterior: Posterior) -> FullCovariancePrior:
    """Return the posterior as a Gaussian with one covariance matrix."""
    if isinstance(posterior, ObservationSpacePosterior) and is_matrix(posterior.prior):
        matrix = one_matrix(posterior.prior)
        if not posterior.n:
            return matrix
        return matrix.downdate(posterior.mean, posterior.whitened_cross())
    return full_covariance_prior(posterior.mean, posterior.covariance(), posterior.n_levels)


def to_full_covariance(posterior: Posterior) -> ObservationSpacePosterior:
    """Return the same posterior as a full-covariance prior without rows."""
    if (
        isinstance(posterior, ObservationSpacePosterior)
        and isinstance(posterior.prior, FullCovariancePrior)
        and posterior.n == 0
    ):
        return posterior
    return initial(full_covariance_of(posterior), posterior.bias_sensitivity())


def as_prior(posterior: Posterior) -> tuple[ConditionedPrior, Array]:
    """Return the posterior as a prior after rows of any form, and its bias sensitivity.

    Few rows are taken from a prior that stays in parts, many from one matrix.
    """
    if isinstance(posterior, ObservationSpacePosterior):
        prior, most = (
            as_conditioned(posterior.prior, posterior.n_levels),
            _FEW_ROWS * posterior.n_weights,
        )
        if is_matrix(prior):
            most = -1 if posterior.n else _WAITING_ROWS
        if len(prior.gain) + posterior.n_rows <= most:
            if not posterior.n:
                return prior, posterior.prior_bias_sensitivity
            shape = (-1, *posterior.prior_bias_sensitivity.shape[1:])
            rows = posterior.rows_in(posterior.profile_basis), posterior.whitened_cross()
            after, change = prior.after_rows(
                posterior.forward, *(each.reshape(shape) for each in rows)
            )
            return after, posterior.prior_bias_sensitivity + change
    whole = as_conditioned(full_covariance_of(posterior), posterior.n_levels)
    return whole, posterior.bias_sensitivity()


def inflated(posterior: Posterior, factor: float) -> Posterior:
    """Return a posterior whose covariance is multiplied by a factor, in the same form.

    With a prior covariance f P0 and rows whose noise is f times as large, the mean is the same and the covariance f P. Rows in units of
    their noise are divided by the root of f, so that the covariance of the rows, and its factors, stay as they are.
    """
    return posterior.rescaled(_scaled(posterior.prior, factor), factor)


def _scaled(prior: Prior, factor: float) -> Prior:
    """Return a prior with its covariance multiplied by a factor; one matrix stays one, which can be merged with rows."""
    if isinstance(prior, FullCovariancePrior):
        return FullCovariancePrior(prior.mean, factor * prior.blocks)
    if isinstance(prior, ConditionedPrior):
        return prior.scaled(_scaled(prior.before, factor), factor)
    if isinstance(prior, ScaledPrior):
        return replace(prior, amplitude=factor * prior.amplitude)
    return ScaledPrior(prior, factor)


# Not slotted: the parts are computed when they are first asked for.
@dataclass(frozen=True, eq=False)
class PosteriorCovariance:
    """The covariance of a posterior's weights, a ``FactoredCovariance``.

    Attributes:
        posterior: The posterior.
    """

    posterior: Posterior

    def __call__(self, levels: Levels | None) -> Array:
        """Return the covariance of some levels' weights, None for all, as one matrix, shape (L r, L r)."""
        return self.posterior.covariance(levels)

    def of_sum(self, levels: Levels) -> Array:
        """Return the covariance of the sum of some levels' weights, shape (r, r)."""
        if levels not in self._known:
            self._known[levels] = self.posterior.prior.of_sum(levels) - self._reduction(levels)
        return self._known[levels]

    def of_combinations(self, design: Array) -> Array:
        """Return the covariance of combinations of the weights, shape (m, m); ``design`` of shape (m, Z, r)."""
        return self.posterior.covariance_of(design)

    def factors(self) -> CovarianceFactors | None:
        """Return the factors to keep; None where the matrix has fewer elements, or the prior is of another kind."""
        conditioned = (
            self.posterior.prior if isinstance(self.posterior.prior, ConditionedPrior) else None
        )
        prior = hybrid_parts(self.posterior.prior if conditioned is None else conditioned.before)
        if prior is None:
            return None
        _, n_levels, n_modes = prior.factor.shape
        whole = half_size(n_levels * n_modes)
        most = sum(n_stored(prior, size) < whole for size in range(n_modes + 1)) - 1
        taken = self.posterior.taken(most) if most >= 0 else None
        if conditioned is not None and taken is not None:
            taken = taken_in_all(conditioned, *taken, most)
        return None if taken is None else CovarianceFactors(prior, taken[0], symmetric(taken[1]))

    @cached_property
    def _reduction(self) -> Reduction:
        return self.posterior.reduction()

    @cached_property
    def _known(self) -> dict[Levels, Array]:
        return {}


def taken_in_all(
    prior: ConditionedPrior, directions: Array, matrix: Array, most: int
) -> tuple[Array, Array] | None:
    """Return what all rows took from the covariance before any of them, as ``Posterior.taken`` does; None with more than ``most``.

    Args:
        prior: After the first rows.
        directions: shape (s, r), B of further rows.
        matrix: shape (Z s, Z s), M of what they took from the prior's covariance.
        most: Number of directions.
    """
    n_rows, n_levels, n_modes = prior.whitened.shape
    mode_std = nonzero_mode_std(prior.before)
    own, further = prior.whitened.reshape(-1, n_modes) * mode_std, directions * mode_std
    # rows enter by what they span, however long they are
    spanning = np.concatenate([each / (np.linalg.norm(each) or 1.0) for each in (own, further)])
    if len(spanning) > n_modes:
        spanning = scipy.linalg.qr(spanning, mode="r")[0][:n_modes]
    found = orthonormal(spanning)
    if len(found) > most:
        return None
    inside = (own @ found.T).reshape(n_rows, n_levels * len(found))
    change = np.einsum("yz,sd->yszd", np.eye(n_levels), further @ found.T).reshape(
        len(matrix), inside.shape[1]
    )
    change -= (prior.gain @ directions.T).reshape(n_rows, len(matrix)).T @ inside
    return found / mode_std, inside.T @ inside + change.T @ matrix @ change


def prefetch(posterior: Posterior, rows: Iterable[Rows | None]) -> Iterator[PriorCrossCovariance]:
    """Return the parts of coming predictions that do not depend on the order of assimilation.

    They end at the first rows of several places, after which there is another prior.
    """
    before = takewhile(lambda each: each is None or each.at_one_place, rows)
    profiles = [each for each in before if each is not None and each.at_one_place]
    return iter(posterior.prefetch(profiles) if profiles else ())


class PathProducts:
    """Products of a prior with sums over several places: those of coming ones are made together, as reading the prior takes longest."""

    def __init__(self, coming: Iterable[Rows | None]) -> None:
        """Begin with the rows of a block."""
        self._coming = [each for each in coming if each is not None and not each.at_one_place]
        self._prior: Prior | None = None
        self._made: list[Array] = []

    def of(self, prior: Prior, rows: PathRows) -> Array:
        """Return the product of the block's next rows, shape (m, Z, r)."""
        while self._coming[0] is not rows:
            del self._coming[0], self._made[:1]
        if self._prior is not prior:
            parts = [each.by_level for each in self._coming]
            ends = np.cumsum([len(each) for each in parts])[:-1]
            self._prior = prior
            self._made = np.split(prior.matvec(np.concatenate(parts)), ends)
        return self._made[0]


def predict(
    posterior: Posterior,
    rows: Rows,
    prefetched: Iterator[PriorCrossCovariance],
    products: PathProducts | None = None,
) -> PredictedObservation[Posterior]:
    """Return the prediction of rows; of those at one place the next of ``prefetched`` is theirs, of others ``products`` has theirs."""
    if rows.at_one_place:
        return posterior.predict(rows, next(prefetched))
    return predict_path_mean(posterior, rows, products or PathProducts([rows]))


def predict_path_mean(
    posterior: Posterior, rows: PathRows, products: PathProducts
) -> PredictedObservation[Posterior]:
    """Return the prediction of sums over several places; its update gives a prior without rows, as these have no single place."""
    prior, bias_sensitivity = as_prior(posterior)
    design = rows.by_level
    cross = prior.less_taken(design, products.of(prior.before, rows))

    def update(lower: Array, whitened: Array, error_scale: float) -> ObservationSpacePosterior:
        scaled = np.stack([design, cross]).reshape(2, len(cross), -1) / error_scale
        solved = (np.asarray(solve_triangular(lower, each, lower=True)) for each in scaled)
        after, change = prior.after_rows(whitened, *(each.reshape(cross.shape) for each in solved))
        return initial(after, bias_sensitivity + change)

    cov = rows.matvec(cross)
    of_mean = prior.mean.reshape(1, *design.shape[1:])
    means = rows.matvec(np.vstack([of_mean, bias_sensitivity])).T
    return PredictedObservation(means, 0.5 * (cov + cov.T), update)
