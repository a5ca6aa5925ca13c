"""The gate of many profiles at once: what ``gate.gate_innovation`` and ``rows.dependence_inflation`` say of each."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from replay_kit.config.gating import GatingConfig
from replay_kit.core.arrays import Array
from replay_kit.core.observation import Decision
from replay_kit.estimator.update import gate as single
from replay_kit.estimator.update.profile_stack import ProfileStack

DECISIONS: tuple[Decision, ...] = ("accepted", "softened", "rejected")


@dataclass(frozen=True, slots=True, eq=False)
class GroupGate:
    """The gate's decisions on n profiles of q unknowns a component.

    Attributes:
        decision: shape (n,), position in ``DECISIONS``.
        statistic: shape (n,); see ``GateResult``.
        threshold: shape (n,).
        exceeds: shape (n,), whether a profile exceeds the gate.
        inflation: shape (n,), factor on the error variance, with that of dependent residuals.
        dof: shape (n,), number of compressed rows.
        variance: shape (n, 2 q), eigenvalues of the rows' predicted covariance; 0 beyond them.
        vectors: shape (n or 1, 2 q, 2 q), eigenvectors.
        along: shape (n, 2 q), innovations along these.
        residual_square: shape (n,), of the compression.
    """

    decision: NDArray[np.intp]
    statistic: Array
    threshold: Array
    exceeds: NDArray[np.bool_]
    inflation: Array
    dof: NDArray[np.intp]
    variance: Array
    vectors: Array
    along: Array
    residual_square: Array

    @property
    def accepted(self) -> NDArray[np.bool_]:
        """Which profiles are assimilated."""
        return np.asarray(self.decision < DECISIONS.index("rejected"))

    @property
    def nis(self) -> Array:
        """Normalised innovation squared of all measured values, with the stated errors, shape (n,)."""
        return np.asarray(
            np.sum(self.along**2 / (self.variance + 1.0), axis=1) + self.residual_square
        )

    def result(self, i: int) -> single.GateResult:
        """Return the result of one profile."""
        decision, dof = DECISIONS[self.decision[i]], int(self.dof[i])
        statistic, threshold, exceeds = (
            float(self.statistic[i]),
            float(self.threshold[i]),
            bool(self.exceeds[i]),
        )
        return single.GateResult(
            decision, statistic, dof, threshold, exceeds, float(self.inflation[i]), self.variance[i]
        )

    def scale_jacobians(self, stack: ProfileStack) -> Array:
        """Return what each profile has of ``biases.scale_jacobian``, shape (n,)."""
        first = stack.observations[0]
        if first.platform_velocity is None or not np.isfinite(first.common_std):
            return np.zeros(len(self.decision))
        common = np.array([observation.common_std for observation in stack.observations])
        rows = np.matmul(stack.of("rows"), stack.used[..., None].astype(np.float64))[..., 0]
        q, over = rows.shape[1], 1.0 / (self.variance + self.inflation[:, None])
        turned = [
            np.matmul(self.vectors.swapaxes(1, 2)[:, :, c * q : (c + 1) * q], rows[..., None])[
                ..., 0
            ]
            for c in range(2)
        ]
        shared = common**2 * sum(np.sum(part**2 * over, axis=1) for part in turned)
        return np.asarray((2.0 - shared) * np.sum(self.along**2 * over, axis=1) / self.dof)

    @staticmethod
    def joined(parts: "Sequence[GroupGate]") -> "GroupGate":
        """Return the decisions on several parts of a group as one."""
        names = ("decision", "statistic", "threshold", "exceeds", "inflation", "dof", "variance")
        whole = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
        vectors = np.concatenate(
            [
                np.broadcast_to(part.vectors, (len(part.along), *part.vectors.shape[1:]))
                for part in parts
            ]
        )
        along, residual = (
            np.concatenate([getattr(part, name) for part in parts])
            for name in ("along", "residual_square")
        )
        return GroupGate(**whole, vectors=vectors, along=along, residual_square=residual)


def gate_profiles(
    stack: ProfileStack, mean: Array, cov: Array, how: tuple[GatingConfig | None, bool, bool]
) -> GroupGate:
    """Return the gate's decisions on profiles.

    Args:
        stack: The profiles.
        mean: shape (n or 1, 2, q), predicted rows.
        cov: shape (n or 1, 2 q, 2 q), their covariance.
        how: Gate (None accepts everything), whether errors grow where residuals are correlated along a profile, and whether recent
            innovations agree with the estimate.
    """
    config, correlated, is_consistent = how
    n = len(stack.observations)
    values, vectors = np.linalg.eigh(cov)
    values = np.broadcast_to(np.maximum(values, 0.0), (n, values.shape[1]))
    innovation = (stack.y - mean).reshape(n, -1)
    along = np.matmul(vectors.swapaxes(1, 2), innovation[..., None])[..., 0]
    dof, residual_dof = (
        np.broadcast_to(each, n).astype(np.intp)
        for each in (2 * stack.of("k"), stack.of("dof") - 2 * stack.of("k"))
    )
    scale, square = np.ones(n), stack.residual_square
    if config and config.adapt_errors:
        noisy = (residual_dof > 0) & (square > _thresholds(config.gate_probability, residual_dof))
        scale = np.where(noisy, square / np.maximum(residual_dof, 1), 1.0)
    squared = along**2 / (values + scale[:, None])
    statistic, threshold, exceeds, decision = (
        squared.sum(axis=1),
        np.full(n, np.inf),
        np.zeros(n, np.bool_),
        np.zeros(n, np.intp),
    )
    if config is not None and config.gate != "off":
        threshold = _thresholds(config.gate_probability, dof)
        one = np.array(
            [
                single.chi_square_threshold(config.gate_probability / rows, 1)
                for rows in dof.tolist()
            ]
        )
        significant = values > single.SIGNIFICANT_SHARE * scale[:, None]
        exceeds = (statistic > threshold) | np.any(significant & (squared > one[:, None]), axis=1)
        decision = np.where(exceeds, DECISIONS.index("rejected"), 0)
        soft = np.full(n, config.gate == "soften") | (exceeds & (not is_consistent))
        softened = single.softened_variance(values, scale[:, None], along, single.SOFTENING).max(
            axis=1
        )
        decision = np.where(
            soft,
            np.where(softened > scale * single.LEAST_SOFTENING, DECISIONS.index("softened"), 0),
            decision,
        )
        scale = np.where(soft, softened, scale)
    if correlated:
        share = values / (values + scale[:, None]) * along
        rows = mean + np.matmul(vectors, share[..., None])[..., 0].reshape(n, 2, -1)
        residual = stack.whitened_misfit(rows) / np.sqrt(scale)[:, None, None]
        further = _dependence(residual, np.broadcast_to(stack.of("dof"), n))
        scale = np.where(decision == DECISIONS.index("rejected"), scale, scale * further)
    return GroupGate(
        decision, statistic, threshold, exceeds, scale, dof, values, vectors, along, square
    )


def _thresholds(probability: float, dof: NDArray[np.intp]) -> Array:
    return np.array(
        [
            single.chi_square_threshold(probability, number) if number else np.inf
            for number in dof.tolist()
        ]
    )


def _dependence(residual: Array, size: NDArray[np.intp]) -> Array:
    """Return ``dependence_inflation`` of each profile, shape (n,); ``residual``, shape (n, m, 2), is 0 beyond ``size`` values."""
    square = np.sum(residual**2, axis=(1, 2))
    product = np.sum(residual[:, 1:] * residual[:, :-1], axis=(1, 2))
    rho = np.divide(product, square, out=np.zeros_like(square), where=square > 0.0)
    rho = np.where((rho > 3.0 / np.sqrt(size)) & (size > 2), rho, 0.0)
    return np.where(rho > 0.0, (1.0 + rho) / (1.0 - rho) * np.maximum(1.0, square / size), 1.0)
