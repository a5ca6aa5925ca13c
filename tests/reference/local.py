"""The current beside an estimate, written out: moments of an average of Ornstein-Uhlenbeck processes, term by term."""

import numpy as np


def moments(local, time_ns):
    """Return mean, shape (2,), and covariance, shape (2, 2), of the current at a time."""
    seconds = max(time_ns - local.time_ns, 0) / 1e9
    mean, second = np.zeros(2), np.zeros((2, 2))
    for k, probability in enumerate(local.probability):
        kept = np.exp(-seconds / local.scale[k])
        of_process = kept * local.mean[k]
        cov = kept * kept * local.cov[k] + (1.0 - kept * kept) * local.std[k] ** 2 * np.eye(2)
        mean += probability * of_process
        second += probability * (cov + np.outer(of_process, of_process))
    return mean, second - np.outer(mean, mean)


def lagged(local, earlier_ns, later_ns):
    """Return the covariance of the current at two times, shape (2, 2): what is known of the first decays to the second."""
    (first, _), (second, _) = moments(local, earlier_ns), moments(local, later_ns)
    at, between = (
        max(earlier_ns - local.time_ns, 0) / 1e9,
        (later_ns - max(earlier_ns, local.time_ns)) / 1e9,
    )
    product = np.zeros((2, 2))
    for k, probability in enumerate(local.probability):
        kept, later = np.exp(-at / local.scale[k]), np.exp(-between / local.scale[k])
        of_process = kept * local.mean[k]
        cov = kept * kept * local.cov[k] + (1.0 - kept * kept) * local.std[k] ** 2 * np.eye(2)
        product += probability * later * (cov + np.outer(of_process, of_process))
    return product - np.outer(first, second)
