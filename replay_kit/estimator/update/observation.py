"""An observation looked at: whether it is believed, with what errors, and what it said. The same for every form of the estimate."""

from dataclasses import dataclass, replace
from typing import Generic

import numpy as np
from numpy.typing import NDArray

from replay_kit.config.gating import TrustConfig
from replay_kit.core.arrays import Array
from replay_kit.core.observation import Innovation, Observation, PathMean
from replay_kit.estimator.update.biases import Evidence, stretch
from replay_kit.estimator.update.gate import Verdict, judge
from replay_kit.estimator.update.kalman import Bins, dependence_inflation
from replay_kit.estimator.update.posterior import After, Look
from replay_kit.estimator.update.screening import scatter


@dataclass(frozen=True, eq=False)
class Looked(Generic[After]):
    """What was made of an observation's rows.

    Attributes:
        bins: The rows.
        values: shape (n, 2) [m/s], of the usable bins, about the same as the rows.
        look: What was expected of the rows.
        innovation: shape (m,), rows minus their expected mean.
        verdict: On the observation.
        inflation: Of the error variance, in the update.
        after: shape (m,), the rows' mean once they count; as expected when they were rejected.
    """

    bins: Bins
    values: Array
    look: Look[After]
    innovation: Array
    verdict: Verdict
    inflation: float
    after: Array

    @property
    def believed(self) -> bool:
        """Whether the observation counts."""
        return self.verdict.decision != "rejected"

    @property
    def error_scale(self) -> float:
        """Standard deviation of the rows' noise, in the update."""
        return float(np.sqrt(self.inflation))

    @property
    def innovation_cov(self) -> Array:
        """Covariance of the innovation, with the errors of the update, shape (m, m)."""
        return self.look.cov + self.inflation * np.eye(self.innovation.size)

    def evidence(self, before: Evidence, observation: Observation | PathMean, columns: Array | None) -> Evidence:
        """Return the evidence of the instrument's errors after the observation; one that is not believed says nothing.

        Args:
            before: Of the observations before.
            observation: The observation.
            columns: shape (m, 3), what errors of one unit do to its rows; None where it says nothing of them.
        """
        if not self.believed or columns is None:
            return before
        stretched = stretch(observation, len(self.values), self.bins, self.innovation, self.innovation_cov)
        return before.after(columns - self.look.answers, self.innovation, self.innovation_cov, stretched)

    def said(self, said: Innovation, used: NDArray[np.intp], prior: Array, grown: float) -> Innovation:
        """Return the innovation.

        Args:
            said: What is said of the observation before it is looked at.
            used: Positions of the usable bins.
            prior: shape (m,), the rows' mean without any observation.
            grown: Factor on the estimate's covariance after it.
        """
        bins, values, size = self.bins, self.values, said.depth.size
        _, left_out = bins.compress(values)
        variance = bins.expand_variance(self.look.cov) + np.square(bins.noise.std)[:, None]
        return replace(
            said,
            innovation=scatter(size, used, bins.misfit(values, self.look.mean)),
            innovation_std=scatter(size, used, np.sqrt(variance)),
            residual=scatter(size, used, bins.misfit(values, self.after)),
            prior_innovation=scatter(size, used, bins.misfit(values, prior)),
            nis=self.look.nis(self.innovation) + left_out,
            dof=bins.dof,
            accepted=self.believed,
            error_inflation=self.inflation,
            decision=self.verdict.decision,
            gate_statistic=self.verdict.statistic,
            gate=self.verdict.gate,
            signal_dof=self.verdict.signal_dof(self.inflation) if self.believed else 0.0,
            prior_inflation=grown,
        )


def look_at(bins: Bins, values: Array, look: Look[After], trust: TrustConfig | None, correlated: bool, settled: bool) -> Looked[After]:
    """Return what is made of an observation.

    Args:
        bins: Its rows.
        values: shape (n, 2) [m/s], of the usable bins, about the same as the rows.
        look: What is expected of the rows.
        trust: Gate; None believes everything.
        correlated: Whether errors grow where residuals are correlated along the profile (not under the paper's error model).
        settled: Whether the estimate has been right of late.
    """
    compressed, left_out = bins.compress(values)
    innovation = compressed - look.mean
    verdict = judge(innovation, look.cov, left_out, bins.dof - innovation.size, trust, settled)
    if verdict.decision == "rejected":
        return Looked(bins, values, look, innovation, verdict, 1.0, look.mean)
    inflation = verdict.inflation
    after = look.mean_after(innovation, np.sqrt(inflation))
    if correlated and len(values) > 1:
        further = dependence_inflation(bins.deviation(values, after) / np.sqrt(inflation))
        if further > 1.0:
            inflation *= further
            after = look.mean_after(innovation, np.sqrt(inflation))
    return Looked(bins, values, look, innovation, verdict, inflation, after)
