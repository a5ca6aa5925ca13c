"""How faults are undone: the turn by a declination, which everything else follows from."""

import numpy as np

from replay_kit.measurements.consistency.usual_faults import turned_clockwise


def test_vectors_turn_clockwise():
    np.testing.assert_allclose(
        turned_clockwise(np.array([[0.0, 1.0], [1.0, 0.0]]), 90.0),
        [[1.0, 0.0], [0.0, -1.0]],
        atol=1e-15,
    )
