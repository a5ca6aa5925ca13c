"""The amplitude of the prior's covariance as a log goes on: what it was fitted to, and what the next fit needs.

The first fit is to members left out. Profiles of the log follow: after 8, 16 and 32 of them that lie apart, the amplitude is fitted to
their innovations from the prior alone, centred on the first fit, and all measurements so far are assimilated again under it. An estimate
is thus never made with an amplitude that later measurements had a part in. Profiles near one another repeat one innovation of the prior,
so they count once.
"""

from dataclasses import dataclass, replace

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.observation import Measurement, Observation

# Numbers of profiles at which the amplitude is fitted.
_COUNTS = (8, 16, 32)
# Measurements that are kept for the next fit at most: a vehicle may stay at one place.
_MOST_KEPT = 1024


@dataclass(frozen=True, slots=True, eq=False)
class SpreadFit:
    """The amplitude of the prior's covariance in a state.

    Attributes:
        amplitude: Factor on the covariance.
        expected: That of members left out.
        fitted_to: Number of profiles that it was fitted to; 0 for members left out.
        spacing: Least distance between profiles that count [m].
        profiles: Those that count so far, with their places; none after the last fit.
        past: All measurements so far; None after the last fit.
    """

    amplitude: float
    expected: float
    fitted_to: int
    spacing: float
    profiles: tuple[tuple[Observation, Array], ...] = ()
    past: tuple[Measurement, ...] | None = ()

    @property
    def is_due(self) -> bool:
        """Whether the amplitude is to be fitted now."""
        return len(self.profiles) in _COUNTS and len(self.profiles) > self.fitted_to

    def after(self, measurement: Measurement, place: Array | None) -> "SpreadFit":
        """Return the same after a measurement.

        Args:
            measurement: The measurement.
            place: shape (2,) [m], of an accepted profile, local east and north; None of anything else.
        """
        if self.past is None:
            return self
        if len(self.past) == _MOST_KEPT:
            return replace(self, profiles=(), past=None)
        profiles = self.profiles
        if place is not None and isinstance(measurement, Observation):
            apart = all(np.hypot(*(place - other)) >= self.spacing for _, other in profiles)
            profiles = (*profiles, (measurement, place)) if apart else profiles
        return replace(self, profiles=profiles, past=(*self.past, measurement))

    def fitted(self, amplitude: float) -> "SpreadFit":
        """Return the same with the amplitude of its profiles; after the last fit nothing is kept."""
        done = replace(self, amplitude=amplitude, fitted_to=len(self.profiles))
        return replace(done, profiles=(), past=None) if done.fitted_to == _COUNTS[-1] else done

    def __str__(self) -> str:
        """Return the amplitude and what it rests on."""
        rests_on = f"{self.fitted_to} profiles of the log" if self.fitted_to else "members left out, no profile of the log"
        return f"variance of the prior multiplied by {self.amplitude:.2f}, fitted to {rests_on}"
