"""Obvious slow twins of what predicts dives."""

import numpy as np


def conditional(error, cov, known):
    """Errors of the values not known given the known ones, and their standard deviations, by the precision matrix."""
    precision = np.linalg.inv(cov)
    own = np.linalg.inv(precision[np.ix_(~known, ~known)])
    return error[~known] + own @ precision[np.ix_(~known, known)] @ error[known], np.sqrt(
        np.diag(own)
    )


def column(profiles, depths):
    """Mean velocity at each depth over profiles, bin by bin."""
    out = []
    for depth in depths:
        found = [
            p.velocity[k]
            for p in profiles
            for k in range(p.depth.size)
            if p.depth[k] == depth and p.flags[k] in (1, 3)
        ]
        out.append(np.mean(found, axis=0))
    return np.array(out)
