"""Settings of the hybrid prior, and its two covariances as matrices, for few modes.

Every member is used unshifted and, with half the weight each, shifted by one correlation length to the four sides: the shape of eddies
in the members holds for eddies nearby too (spatial averages of covariances, Berre and Desroziers 2010, Mon. Wea. Rev. 138;
valid-space shifting, Xu et al. 2011). The sample covariance of so many members still contains chance correlations between distant
places, and has low rank. The localised part (hybrid covariance, Hamill and Snyder 2000) has full rank and no distant correlations: for
each empirical orthogonal function of depth, the covariance over the grid is tapered with distance (Gaspari and Cohn 1999) and
projected on the modes (``localised.py``).
"""

from dataclasses import dataclass

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.estimator.basis.shifts import ShiftedModes
from replay_kit.estimator.prior.localised import localised_part


@dataclass(frozen=True, slots=True)
class PriorSettings:
    """The settings of a hybrid prior.

    Attributes:
        sample_share: Of the sample covariance; the localised one has the rest.
        shift: Distance of the shifted copies [m]; 0 makes none.
        radius: Where the localised part's taper reaches zero [m].
    """

    sample_share: float
    shift: float
    radius: float

    def __str__(self) -> str:
        """Return the settings in words."""
        shift, radius = self.shift / 1e3, self.radius / 1e3
        return f"sample share {self.sample_share:.2f}, members shifted by {shift:.1f} km, taper to zero at {radius:.1f} km"


def covariances(member_weights: Array, modes: ShiftedModes, radius: float) -> tuple[Array, Array]:
    """Return the sample covariance of members and shifted copies, and the localised one, shapes (Z r, Z r).

    Args:
        member_weights: shape (E, Z, r).
        modes: With what shifts fields in them.
        radius: Where the taper reaches zero [m].
    """
    n_members, n_levels, n_modes = member_weights.shape
    anomalies = member_weights - member_weights.mean(axis=0)
    copies = modes.copies(anomalies / np.sqrt(n_members - 1.0))
    rows = copies.reshape(len(copies), -1)
    vertical, horizontal = localised_part(copies, modes, radius)
    localised = np.zeros((n_levels, n_modes, n_levels, n_modes))
    last = len(horizontal) - 1
    for group, of_modes in enumerate(horizontal):
        own = vertical[group : None if group == last else group + 1]
        localised += np.einsum("qz,qy,rs->zrys", own, own, of_modes, optimize=True)
    return rows.T @ rows, localised.reshape(rows.shape[1], -1)
