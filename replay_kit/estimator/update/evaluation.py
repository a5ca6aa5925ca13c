"""The evaluation of an observation against its prediction: gate, errors and innovation, the same for every estimator with a basis."""

from dataclasses import dataclass, replace
from typing import Generic

import numpy as np

from replay_kit.config.gating import GatingConfig
from replay_kit.core.arrays import Array
from replay_kit.core.observation import Innovation, Measurement, PathMean
from replay_kit.estimator.update.biases import BiasScore, scale_jacobian
from replay_kit.estimator.update.compression import Bins, dependence_inflation
from replay_kit.estimator.update.gate import GateResult, gate_innovation
from replay_kit.estimator.update.posterior import After, PredictedObservation
from replay_kit.estimator.update.screening import Screened


@dataclass(frozen=True, eq=False)
class ObservationUpdate(Generic[After]):
    """The result of evaluating an observation.

    Attributes:
        bins: The observation's rows.
        predicted: Their prediction.
        innovation: shape (m,), rows minus their predicted mean.
        gate: The gate's decision.
        inflation: Factor on the error variance in the update.
        posterior_mean: shape (m,), the rows' mean after the update; the predicted mean when the observation was rejected.
    """

    bins: Bins
    predicted: PredictedObservation[After]
    innovation: Array
    gate: GateResult
    inflation: float
    posterior_mean: Array

    @property
    def accepted(self) -> bool:
        """Whether the observation is assimilated."""
        return self.gate.decision != "rejected"

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
        return nis, -0.5 * nis - half_log_det - 2.0 * self.bins.noise.half_log_det

    def bias_score(
        self, before: BiasScore, observation: Measurement, bias_rows: Array | None
    ) -> BiasScore:
        """Return the score of the instrument errors after the observation; a rejected one does not count.

        Args:
            before: Score of the observations before.
            observation: The observation.
            bias_rows: shape (m, 3), effect of errors of one unit on its rows; None where the log does not state it.
        """
        if not self.accepted or bias_rows is None:
            return before
        jacobian = scale_jacobian(observation, self.bins, self.innovation, self.innovation_cov)
        return before.updated(
            bias_rows - self.predicted.bias_sensitivity,
            self.innovation,
            self.innovation_cov,
            jacobian,
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
        variance = bins.expand_variance(self.predicted.cov) + np.square(bins.noise.std)[:, None]
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
            estimated_std=self._posterior_std()
            if isinstance(screened.observation, PathMean)
            else np.nan,
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
    gate = gate_innovation(
        innovation, predicted.cov, (residual, bins.dof - innovation.size), gating, is_consistent
    )
    if gate.decision == "rejected":
        return ObservationUpdate(bins, predicted, innovation, gate, 1.0, predicted.mean)
    inflation = gate.inflation
    posterior_mean = predicted.posterior_mean(innovation, np.sqrt(inflation))
    if correlated and len(bins.values) > 1:
        further = dependence_inflation(bins.whitened_residual(posterior_mean) / np.sqrt(inflation))
        if further > 1.0:
            inflation *= further
            posterior_mean = predicted.posterior_mean(innovation, np.sqrt(inflation))
    return ObservationUpdate(bins, predicted, innovation, gate, inflation, posterior_mean)
