"""Which errors one part of a study may end with while the others go on."""

import numpy as np

from replay_kit.core.errors import EstimatorError, ForecastError, MeasurementError, PlanError

#: A matrix that cannot be factorised, and inputs that one method or study cannot use. A wrong option (``ConfigError``) concerns the
#: whole run, and any other error is a bug: neither is kept as a result.
EXPECTED_FAILURES = (np.linalg.LinAlgError, EstimatorError, ForecastError, MeasurementError, PlanError)


def reason_of(error: Exception) -> str:
    """Return the reason of a failure as results state it: the error's class and message."""
    return f"{type(error).__name__}: {error}"
