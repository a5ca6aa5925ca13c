"""The array that values hold: float64, never written to after it is made."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
