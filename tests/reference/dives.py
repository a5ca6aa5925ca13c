"""Obvious slow twins of what predicts dives."""

import numpy as np


def conditional(error, cov, known):
    """Errors of the values not known given the known ones, and their standard deviations, by the precision matrix."""
    precision = np.linalg.inv(cov)
    own = np.linalg.inv(precision[np.ix_(~known, ~known)])
    return error[~known] + own @ precision[np.ix_(~known, known)] @ error[known], np.sqrt(
        np.diag(own)
    )


def joint(estimator, profiles):
    """Mean, covariance and values of all bins of static profiles at once; each dive has unknowns of its own."""
    part = estimator.state_space.parts["dive_error"]
    dives = sorted({profile.dive for profile in profiles})
    size = part.stop - part.start
    rows, noise, values = [], [], []
    for profile in profiles:
        seen = estimator.operator.profile(profile, np.arange(profile.depth.size))
        k = seen.q.shape[1]
        for c in range(2):
            design = seen.noise.unwhiten @ seen.q @ seen.design[c * k : (c + 1) * k]
            row = np.zeros((len(design), part.start + len(dives) * size))
            row[:, : part.start] = design[:, : part.start]
            at = part.start + dives.index(profile.dive) * size
            row[:, at : at + size] = design[:, part]
            rows.append(row)
            noise.append(seen.noise.unwhiten @ seen.noise.unwhiten.T)
            values.append(seen.values[:, c])
    whole = np.vstack(rows)
    cov = whole @ whole.T
    start = 0
    for block in noise:
        cov[start : start + len(block), start : start + len(block)] += block
        start += len(block)
    return np.zeros(len(whole)), cov, np.concatenate(values)


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
