"""The current beside an estimate, written out: moments of an average of Ornstein-Uhlenbeck processes, term by term."""

import numpy as np


def mean(local, time_ns):
    """Return the mean of the current at a time, shape (2,)."""
    seconds = max(time_ns - local.time_ns, 0) / 1e9
    processes = zip(local.probability, local.scale, local.mean, strict=True)
    return sum(
        share * np.exp(-seconds / scale) * of_process for share, scale, of_process in processes
    )


def moments(local, time_ns):
    """Return mean, shape (2,), and covariance, shape (2, 2), of the current at a time."""
    return mean(local, time_ns), lagged(local, time_ns, time_ns)


def lagged(local, earlier_ns, later_ns):
    """Return the covariance of the current at two times, shape (2, 2): what is known of the first decays to the second."""
    at, after = (max(time_ns - local.time_ns, 0) / 1e9 for time_ns in (earlier_ns, later_ns))
    product = np.zeros((2, 2))
    for k, probability in enumerate(local.probability):
        kept, later = np.exp(-at / local.scale[k]), np.exp(-(after - at) / local.scale[k])
        of_process = kept * local.mean[k]
        cov = kept * kept * local.cov[k] + (1.0 - kept * kept) * local.std[k] ** 2 * np.eye(2)
        product += probability * later * (cov + np.outer(of_process, of_process))
    return product - np.outer(mean(local, earlier_ns), mean(local, later_ns))
