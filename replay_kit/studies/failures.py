"""What may fail in a part of an experiment without costing the others their results."""

import numpy as np

from replay_kit.core.errors import EstimatorError, ForecastError, MeasurementError, PlanError

#: A matrix that cannot be factorised, and inputs that one method or study cannot use. A wrong option (``ConfigError``) concerns the
#: whole run, and any other error is one of the program: neither is kept as a result.
EXPECTED_FAILURES = (np.linalg.LinAlgError, EstimatorError, ForecastError, MeasurementError, PlanError)


def reason_of(error: Exception) -> str:
    """Return why something failed, as a result says it."""
    return f"{type(error).__name__}: {error}"
