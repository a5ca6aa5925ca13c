"""The representation error of a place, by a search for its nearest node."""

import numpy as np

from replay_kit.core.geodesy import to_local


def error_at(estimator, longitude, latitude):
    """Return it level by level, shape (Z,) [m/s]."""
    grid, std, field = (
        estimator.basis.grid,
        estimator.representation_std,
        estimator.basis.error_field,
    )
    place = np.array(to_local(grid.projection, longitude, latitude), dtype=np.float64)
    return (
        std
        if field is None
        else std * field.relative[:, int(np.argmin(np.hypot(*(grid.nodes - place).T)))]
    )
