"""How an estimate and its stated uncertainty compare with a known truth: pure functions of arrays."""

from dataclasses import dataclass

import numpy as np

from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.gaussian import coverage, crps_gaussian
from replay_kit.workflows.replay.scoring import ScoredPoints, rms_length


@dataclass(frozen=True, slots=True)
class Score:
    """An estimate against the truth over all scored points.

    Attributes:
        rmse: Root mean square length of the error vector [m/s].
        rel_error: ``rmse`` over the truth's RMS speed.
        coverage50: Share of components inside their central 50 % interval; NaN without uncertainty.
        coverage90: Share of components inside their central 90 % interval; NaN without uncertainty.
        crps: Mean continuous ranked probability score of a component [m/s]; the mean absolute error without uncertainty.
    """

    rmse: float
    rel_error: float
    coverage50: float
    coverage90: float
    crps: float


def score(flow: FlowEstimate, at: ScoredPoints) -> Score:
    """Return the scores of an estimate."""
    error = flow.velocity(*at.place) - at.velocity
    rmse = rms_length(error)
    relative = rmse / rms_length(at.velocity)
    if flow.n_modes == 0:
        return Score(rmse, relative, np.nan, np.nan, float(np.mean(np.abs(error))))
    std = flow.standard_error(*at.place)
    return Score(rmse, relative, coverage(error, std, 0.5), coverage(error, std, 0.9), float(np.mean(crps_gaussian(error, std))))
