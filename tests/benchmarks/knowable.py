"""What could be known of a fault by one who knew the errors of the log: the detection bound beside which the checks are measured.

The errors are those of the sound log: Gaussian, of the scatter of its own pairs, with the bias that a flight model has. The likelihood of
each hypothesis under them, and its prior, give the probability of the true cause among all others and none.
"""

import math

import numpy as np
from replay_kit.measurements.consistency import findings
from replay_kit.measurements.consistency.pairs import PairStatistics
from replay_kit.measurements.consistency.sources import SourceStatistics
from replay_kit.measurements.consistency.usual_faults import CAUSES, Hypothesis, hypotheses

from replay_kit.core.arrays import Array

# m/s, and m/s an hour: a bias that pairs share, an offset, a drift
_BIAS, _ADDED = 0.03, {"offset": 0.3, "drift": 0.03}
_CAUSES = {
    findings.SCALE: CAUSES["scale"],
    findings.OFFSET: CAUSES["offset"],
    findings.DRIFT: CAUSES["drift"],
    findings.COMPASS: CAUSES["turn"],
    findings.CONTRADICTION: CAUSES["turn"],
}


def probability(
    sound: SourceStatistics, faulty: SourceStatistics, expected: tuple[str, ...]
) -> float:
    """Return the probability of the causes that are expected, when the errors are known; NaN of a log without pairs."""
    if not faulty.current.pairs:
        return math.nan
    right, every = [-np.inf], [0.0]
    known = {_CAUSES[name] for name in expected if name in _CAUSES}
    for before, pairs, kinds in (
        (sound.current, faulty.current, tuple(CAUSES)),
        (sound.vehicle, faulty.vehicle, ("turn", "mirror", "unit")),
    ):
        for each, gain in _gains(before, pairs, kinds):
            every.append(gain)
            right += [gain] if each.cause in known else []
    return float(np.exp(np.logaddexp.reduce(right) - np.logaddexp.reduce(every)))


def _gains(
    sound: PairStatistics, found: PairStatistics, kinds: tuple[str, ...]
) -> list[tuple[Hypothesis, float]]:
    """Return the logarithm of the odds of each hypothesis to none."""
    if not found.pairs:
        return []
    of_sound, values = np.array(sound.pairs, np.float64), np.array(found.pairs, np.float64)
    variance = float((of_sound[:, :2] - of_sound[:, 2:4]).var(axis=0).mean())
    a, b, hours = values[:, :2], values[:, 2:4], (values[:, 5] - values[0, 5]) / 3.6e12
    basis = {"offset": np.ones(len(a)), "drift": hours}
    shared = variance * np.eye(len(a)) + _BIAS**2
    none, gains = _log_density(a - b, shared), []
    for each in hypotheses():
        if each.kind not in kinds:
            continue
        if each.kind in basis:
            x = _ADDED[each.kind] * basis[each.kind]
            density = _log_density(a - b, shared + np.outer(x, x))
        else:
            stretch = len(a) * math.log(abs(np.linalg.det(each.matrix / each.errors)))
            density = _log_density((a @ each.matrix.T - b) / each.errors, shared) + stretch
        gains.append((each, density - none + math.log(each.prior)))
    return gains


def _log_density(left: Array, covariance: Array) -> float:
    """Return the logarithm of the density of both components of some differences."""
    squares = float(np.sum(left * np.linalg.solve(covariance, left)))
    return -0.5 * squares - float(np.linalg.slogdet(covariance)[1])
