"""Slow obvious twin of the moved centre: the density of all measured values under each component, by dense Gaussians."""

import numpy as np

from tests.reference.estimator import log_density

KERNELS = (1.0, 0.9, 0.8, 0.6, 0.4, 0.25, 0.15)


def moved(members, mean, sample, rest, design, values, profiles, variances, probabilities, kernels):
    """Return the shift of the weights' centre; anomalies (E, W), mean (W,), covariances (W, W), design (K, W), values about w0 (K,)."""
    logs, shifts = [], []
    for kernel, share in zip(KERNELS, kernels, strict=True):
        for member in members:
            shift = np.sqrt(1.0 - kernel) * member
            density = [
                np.log(probability)
                + log_density(
                    values,
                    design @ shift,
                    design @ (kernel * sample + rest + k * np.outer(mean, mean)) @ design.T
                    + np.eye(len(values)),
                )
                for k, probability in zip(variances, probabilities, strict=True)
            ]
            likelihood = np.logaddexp.reduce(density)
            logs.append(np.log(share) + min(1.0, 6.0 / profiles) * likelihood)
            shifts.append(shift)
    weights = np.exp(np.array(logs) - np.max(logs))
    return (weights / weights.sum()) @ np.array(shifts)
