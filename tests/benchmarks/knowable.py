"""What could be known of a fault by one who knew the errors of the log: the detection bound beside which the checks are measured.

The errors are those of the sound log: Gaussian, of the scatter of its own pairs, with the bias that a flight model has. The likelihood of
each alternative under them, and its prior, give the probability of the true cause among all others and none.
"""

import math
from collections.abc import Mapping

import numpy as np

from replay_kit.measurements.checks.causes import COMPASS, CONTRADICTION, DRIFT, OFFSET, SCALE
from replay_kit.measurements.checks.likelihood import CAUSES, KINDS, RELATIVE, family

# m/s, and m/s an hour: a bias that pairs share, an offset, a drift; and the probabilities of these two
_BIAS, _ADDED = 0.03, {"offset": (0.3, 0.15), "drift": (0.03, 0.05)}
_CAUSES = {
    SCALE: CAUSES["scale"],
    OFFSET: CAUSES["offset"],
    DRIFT: CAUSES["drift"],
    COMPASS: CAUSES["turn"],
    CONTRADICTION: CAUSES["turn"],
}


def probability(
    sound: Mapping[str, np.ndarray], faulty: Mapping[str, np.ndarray], expected: tuple[str, ...]
) -> float:
    """Return the probability of the causes that are expected, when the errors are known; NaN of a log without pairs."""
    if not len(faulty.get("current", ())):
        return math.nan
    right, every = [-np.inf], [0.0]
    known = {_CAUSES[name] for name in expected if name in _CAUSES}
    for name, kinds in (("current", KINDS), ("vehicle", RELATIVE)):
        for kind in kinds if len(faulty[name]) and len(sound[name]) else ():
            gain = _gain(sound[name], faulty[name], kind)
            every.append(gain)
            right += [gain] if CAUSES[kind] in known else []
    return float(np.exp(np.logaddexp.reduce(right) - np.logaddexp.reduce(every)))


def _gain(sound, found, kind: str) -> float:
    """Return the logarithm of the odds of all alternatives of a kind to none."""
    variance = float((sound[:, :2] - sound[:, 2:4]).var(axis=0).mean())
    a, b = found[:, 0] + 1j * found[:, 1], found[:, 2] + 1j * found[:, 3]
    shared = variance * np.eye(len(a)) + _BIAS**2
    none = _log_density((a - b)[None], shared)
    if kind in _ADDED:
        size, prior = _ADDED[kind]
        x = size * (np.ones(len(a)) if kind == "offset" else found[:, 5] - found[0, 5])
        logs = _log_density((a - b)[None], shared + np.outer(x, x)) + math.log(prior)
    else:
        of, c = family(kind), b.conj() if kind == "mirror" else b
        left = (a - of.factor[:, None] * c) * of.narrowed[:, None]
        logs = _log_density(left, shared) + 2.0 * len(a) * np.log(of.narrowed) + of.prior
    return float(np.logaddexp.reduce(logs - none))


def _log_density(left, covariance) -> np.ndarray:
    """Return the logarithms of the densities of both components of differences, shape (h, n)."""
    squares = np.einsum("hn,nm,hm->h", left.conj(), np.linalg.inv(covariance), left).real
    return np.asarray(-0.5 * squares - float(np.linalg.slogdet(covariance)[1]))
