"""The prediction of an observation's rows and its evaluation against them: gate, errors and innovation, the same for every estimator."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

import numpy as np
import scipy.linalg

from replay_kit.config.gating import GatingConfig
from replay_kit.core.arrays import Array
from replay_kit.core.gaussian import normalised_square
from replay_kit.core.observation import Innovation, LinearMeasurement
from replay_kit.estimator.update.biases import BiasScore, scale_error_std, scale_jacobian
from replay_kit.estimator.update.gate import ConsistencyMonitor, GateResult, Gates, gate_innovations
from replay_kit.estimator.update.rows import Bins, dependence_inflation
from replay_kit.estimator.update.screening import Screened

_NEW_MONITOR, _NO_SCORE = ConsistencyMonitor(), BiasScore()
After = TypeVar("After")


@dataclass(frozen=True, eq=False)
class PredictedObservation(Generic[After]):
    """The prediction of an observation's rows before they are assimilated.

    Attributes:
        mean: shape (2 k,), of the rows.
        bias_sensitivity: shape (2 k, b), change of the mean for each instrument error of one unit.
        cov: shape (2 k, 2 k), of the rows without their own noise.
        update: Returns the estimate after the rows, given the Cholesky factor of the scaled innovation covariance, the innovation whitened
            by it, and the error scale by which both were divided.
    """

    mean: Array
    bias_sensitivity: Array
    cov: Array
    update: Callable[[Array, Array, float], After]

    def posterior(self, innovation: Array, error_scale: float) -> After:
        """Return the estimate after the rows.

        Args:
            innovation: shape (2 k, 1 + b), see ``augmented_innovation``.
            error_scale: Standard deviation of the rows' independent noise.
        """
        lower = self._factor(error_scale)
        whitened = scipy.linalg.solve_triangular(lower, innovation / error_scale, lower=True)
        return self.update(lower, np.asarray(whitened), error_scale)

    def augmented_innovation(self, innovation: Array, bias_rows: Array | None) -> Array:
        """Return the innovations of the rows and of the instrument errors, shape (2 k, 1 + b).

        Args:
            innovation: shape (2 k,), rows minus their mean.
            bias_rows: shape (2 k, b), effect of errors of one unit on the rows; None where the log does not state it.
        """
        return np.column_stack(
            [innovation, (0.0 if bias_rows is None else bias_rows) - self.bias_sensitivity]
        )

    def posterior_mean(self, innovation: Array, error_scale: float) -> Array:
        """Return the rows' mean in that posterior, shape (2 k,), for an innovation of shape (2 k,)."""
        gained = scipy.linalg.cho_solve((self._factor(error_scale), True), innovation / error_scale)
        return np.asarray(self.mean + self.cov @ gained / error_scale)

    def _factor(self, error_scale: float) -> Array:
        return np.asarray(
            np.linalg.cholesky(self.cov / error_scale**2 + np.eye(self.mean.size)), dtype=np.float64
        )

    def normalised_square(self, innovation: Array) -> tuple[float, float]:
        """Return the rows' normalised innovation squared, with noise of unit variance, and half the covariance's log-determinant."""
        return normalised_square(innovation, self.cov + np.eye(innovation.size))


@dataclass(frozen=True, eq=False)
class StatePrediction(PredictedObservation[tuple[Array, Array]]):
    """The prediction of rows by a state.

    Attributes:
        cross_covariance: shape (m, n), the rows times the state's covariance.
    """

    cross_covariance: Array


def predict_observation(means: Array, cov: Array, design: Array) -> StatePrediction:
    """Return the prediction of rows, whose update gives means and covariance.

    Args:
        means: shape (n, 1 + b): the state's mean, and its sensitivity to each instrument error of one unit.
        cov: shape (n, n).
        design: shape (m, n).
    """
    cross = design @ cov

    def update(lower: Array, whitened: Array, error_scale: float) -> tuple[Array, Array]:
        gain = np.asarray(scipy.linalg.solve_triangular(lower, cross / error_scale, lower=True))
        return means + gain.T @ whitened, cov - gain.T @ gain

    of_rows = cross @ design.T
    return StatePrediction(
        design @ means[:, 0], design @ means[:, 1:], 0.5 * (of_rows + of_rows.T), update, cross
    )


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Assimilation:
    """What every state holds of the measurements so far, beside the estimate.

    Attributes:
        time_ns: Of the last observation used [ns, UTC]; None before the first.
        monitor: Of the latest gate results.
        last: The last measurement with a usable bin; an equal one that follows is a duplicate.
        bias_score: Of systematic errors of the instrument.
    """

    time_ns: int | None = None
    monitor: ConsistencyMonitor = _NEW_MONITOR
    last: LinearMeasurement | None = None
    bias_score: BiasScore = _NO_SCORE


@dataclass(frozen=True, eq=False)
class ObservationUpdate(Generic[After]):
    """The result of evaluating an observation.

    Attributes:
        bins: The observation's rows.
        predicted: Their prediction.
        innovation: shape (m,), rows minus their predicted mean.
        gates: The gate's decision on it alone.
        inflation: Factor on the error variance in the update.
        posterior_mean: shape (m,), the rows' mean after the update; the predicted mean when the observation was rejected.
    """

    bins: Bins
    predicted: PredictedObservation[After]
    innovation: Array
    gates: Gates
    inflation: float
    posterior_mean: Array

    @property
    def gate(self) -> GateResult:
        """The gate's decision."""
        return self.gates.result(0)

    @property
    def accepted(self) -> bool:
        """Whether the observation is assimilated."""
        return bool(self.gates.accepted[0])

    @property
    def error_scale(self) -> float:
        """Standard deviation of the rows' noise in the update."""
        return float(np.sqrt(self.inflation))

    @property
    def innovation_cov(self) -> Array:
        """Covariance of the innovation, with the errors of the update, shape (m, m)."""
        return self.predicted.cov + self.inflation * np.eye(self.innovation.size)

    @property
    def log_likelihood(self) -> float:
        """Logarithm of the measured values' density under the prediction, with the stated errors; without the constant of 2 pi."""
        return self._fit()[1]

    def _fit(self) -> tuple[float, float]:
        """Return the normalised innovation squared of all measured values and their log-likelihood, with the stated errors."""
        square, half_log_det = self.predicted.normalised_square(self.innovation)
        nis = square + self.bins.compress(self.bins.values)[1]
        return nis, -0.5 * nis - half_log_det - self.bins.half_log_det

    def scale_jacobian(self, screened: Screened) -> float:
        """Return what a scale error's score lacks of the observation; see ``biases.scale_jacobian``."""
        std = scale_error_std(screened.observation)
        common = None if std is None else np.array([std])
        ones, inflation = self.bins.ones()[None], np.array([self.inflation])
        return float(scale_jacobian(self.gates, inflation, ones, common)[0])

    def bias_score(
        self, before: BiasScore, screened: Screened, bias_rows: Array | None
    ) -> BiasScore:
        """Return the score of the instrument errors after the observation; a rejected one does not count.

        Args:
            before: Score of the observations before.
            screened: The observation.
            bias_rows: shape (m, 3), effect of errors of one unit on its rows; None where the log does not state it.
        """
        if not self.accepted or bias_rows is None:
            return before
        return before.updated(
            bias_rows - self.predicted.bias_sensitivity,
            self.innovation,
            self.innovation_cov,
            self.scale_jacobian(screened),
        )

    def to_innovation(self, screened: Screened, prior: Array, prior_inflation: float) -> Innovation:
        """Return the innovation to publish.

        Args:
            screened: The observation after screening.
            prior: shape (m,), the rows' mean before any observation.
            prior_inflation: Factor on the estimate's covariance after the observation.
        """
        bins = self.bins
        nis, log_likelihood = self._fit()
        variance = bins.expand_variance(self.predicted.cov, 1.0)
        return replace(
            screened.unused,
            innovation=screened.scatter(bins.residual(self.predicted.mean)),
            innovation_std=screened.scatter(np.sqrt(variance)),
            residual=screened.scatter(bins.residual(self.posterior_mean)),
            prior_innovation=screened.scatter(bins.residual(prior)),
            nis=nis,
            dof=bins.dof,
            accepted=self.accepted,
            error_inflation=self.inflation,
            decision=self.gate.decision,
            gate_statistic=self.gate.statistic,
            gate=self.gate.threshold,
            signal_dof=self.gate.signal_dof(self.inflation) if self.accepted else 0.0,
            prior_inflation=prior_inflation,
            log_likelihood=log_likelihood,
            estimated_std=self._posterior_std() if screened.unused.mean_kind else np.nan,
        )

    def _posterior_std(self) -> float:
        """Return the error of each component of the estimate's mean along a path after the update, as its root mean square [m/s]."""
        cov = self.predicted.cov
        if self.accepted:
            cov = cov - cov @ np.linalg.solve(self.innovation_cov, cov)
        return float(np.sqrt(np.mean(self.bins.expand_variance(cov))))


def evaluate_observation(
    bins: Bins,
    predicted: PredictedObservation[After],
    gating: GatingConfig | None,
    correlated: bool,
    is_consistent: bool,
) -> ObservationUpdate[After]:
    """Return the evaluation of an observation.

    Args:
        bins: Its rows.
        predicted: Their prediction.
        gating: Gate; None accepts everything.
        correlated: Whether errors grow where residuals are correlated along the profile (not under the paper's error model).
        is_consistent: Whether recent innovations agree with the estimate.
    """
    compressed, residual = bins.compress(bins.values)
    innovation = compressed - predicted.mean
    rows = innovation.size
    gates = gate_innovations(
        innovation[None],
        predicted.cov[None],
        np.array([rows]),
        (np.array([residual]), np.array([bins.dof - rows])),
        gating,
        is_consistent,
    )
    if not gates.accepted[0]:
        return ObservationUpdate(bins, predicted, innovation, gates, 1.0, predicted.mean)
    inflation = float(gates.inflation[0])
    posterior_mean = predicted.posterior_mean(innovation, np.sqrt(inflation))
    if correlated and len(bins.values) > 1:
        left = bins.whitened_residual(posterior_mean) / np.sqrt(inflation)
        further = float(dependence_inflation(left[None], np.array([left.size]))[0])
        if further > 1.0:
            inflation *= further
            posterior_mean = predicted.posterior_mean(innovation, np.sqrt(inflation))
    return ObservationUpdate(bins, predicted, innovation, gates, inflation, posterior_mean)
