"""Systematic errors of an instrument: their effect on a profile, and their estimate from the log.

An error that is not part of the state is absorbed by the current where possible, but a turning vehicle shows the same error along another
direction. Each profile's innovation e, with covariance S, is compared with the effect b of an error of one unit:

    s = sum b' S^-1 e,    I = sum b' S^-1 b,    estimate s / I, with standard deviation I^-1/2.

The part of b that the current has absorbed is tracked beside the estimate and subtracted; the result equals that of a state with a flat
prior (Friedland 1969, IEEE TAC 14: separate-bias estimation).

A slightly wrong prior of the current leaves innovations that are correlated for hours, which in a long log would look like an error of a
sound instrument. So the log is divided into parts, and the standard deviation is at least that of the parts' own estimates (White 1982,
Econometrica 50).

A shear error is along the predicted motion through water: in the measured one the water's own shear changes the apparent motion. As a
part of the state it is along the measured one, and biased by some 2e-5 1/s.

A scale error is special, because b is made of the measurement: with z = (1 + s)(v - p) the density of the logged values has a factor
(1 + s)^-1 for each component of the mean, less the share of the platform velocity's error; see ``scale_jacobian``.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.core.gaussian import normalised_square
from replay_kit.core.geodesy import rotate_to_local
from replay_kit.core.grid import Projection
from replay_kit.core.observation import Measurement, Observation, PathMean
from replay_kit.estimator.update.rows import Bins
from replay_kit.estimator.update.screening import Screened

NAMES = ("heading", "scale", "shear")
# Estimates below this number of standard deviations are chance, as three are made for each log.
_SIGNIFICANT = 3.5
# rad, a share, 1/s: smaller ones do no harm
_HARMLESS = (np.deg2rad(2.0), 0.01, 2e-5)
# Largest number of parts of a log (a long one has at least half of it), and the least number whose scatter is meaningful.
_PARTS, _LEAST_PARTS = 32, 8


@dataclass(frozen=True, slots=True, eq=False)
class BiasBins:
    """The effect of one unit of each bias on a profile.

    Attributes:
        depth: shape (n, 2), functions of depth that both components share: one, and the distance from the first bin; none without biases.
        factor: For each component, shape (2, biases).
    """

    depth: Array
    factor: tuple[Array, Array]


@dataclass(frozen=True, slots=True, eq=False)
class Biases:
    """Systematic errors of the instrument, by name.

    ``heading``: the compass reads too high [rad], which turns the velocity relative to the platform clockwise. ``scale``: the relative
    velocity is too large, by a share. ``shear``: an error along the motion through water that grows with the distance from the
    instrument (Todd et al. 2017, JTECH 34). They are proportional to the profile's mean relative velocity: with each bin's own velocity
    its noise would look like a scale error.

    Attributes:
        names: Of the biases.
        std: shape (b,), prior standard deviations: rad, 1, 1/s.
    """

    names: tuple[str, ...]
    std: Array

    @property
    def size(self) -> int:
        """Number of biases."""
        return len(self.names)

    def bins(
        self, depth: Array, relative: Array | None, innovation: Array | None = None
    ) -> BiasBins:
        """Return the effect of one prior standard deviation of each bias on a profile.

        Args:
            depth: shape (n,) [m].
            relative: shape (n, 2) [m/s], velocity relative to the platform, local axes; None when the log does not state it.
            innovation: shape (n, 2) [m/s], measured minus predicted; the motion through water is then that through the predicted
                current. In the measurement the water's own shear changes the apparent motion and looks like a shear error.
        """
        if not self.names:
            return BiasBins(np.empty((depth.size, 0)), (np.empty((0, 0)), np.empty((0, 0))))
        functions = np.column_stack([np.ones(depth.size), np.abs(depth - depth[0])])
        east, north = (0.0, 0.0) if relative is None else relative.mean(axis=0)
        motion = np.array([east, north]) - (0.0 if innovation is None else innovation.mean(axis=0))
        speed = float(np.hypot(*motion))
        factors = []
        for component, (along, across) in enumerate(((east, north), (north, -east))):
            columns = {
                "heading": (across, 0.0),
                "scale": (along, 0.0),
                # the water moves backwards relative to the platform
                "shear": (0.0, -float(motion[component]) / speed if speed > 0.0 else 0.0),
            }
            factors.append(np.column_stack([columns[name] for name in self.names]) * self.std)
        return BiasBins(functions, (factors[0], factors[1]))

    def columns(self, depth: Array, relative: Array, innovation: Array | None = None) -> Array:
        """Return the effect of one prior standard deviation of each bias on the bins, shape (biases, n, 2) [m/s]; see ``bins``."""
        bins = self.bins(depth, relative, innovation)
        return np.stack([bins.depth @ factor for factor in bins.factor], axis=-1).transpose(1, 0, 2)


def relative_velocity(
    observation: Observation, used: NDArray[np.intp], projection: Projection
) -> Array | None:
    """Return the bins' velocity relative to the platform, shape (n, 2) [m/s], local axes; None when the log does not state it."""
    velocity = observation.velocity[used]
    if observation.platform_velocity is not None:
        velocity = velocity - np.array(observation.platform_velocity)
    elif np.isfinite(observation.common_std):
        return None
    return np.column_stack(
        rotate_to_local(projection, observation.longitude, observation.latitude, *velocity.T)
    )


@dataclass(frozen=True, slots=True, eq=False)
class BiasScore:
    """Score and information of the instrument errors so far, in parts of the log with equal numbers of profiles; the last one grows.

    Attributes:
        scores: shape (parts, 3), s of each.
        informations: shape (parts, 3, 3), I of each.
        length: Number of profiles in a part.
        last: Number of profiles in the last part.
    """

    scores: Array = field(default_factory=lambda: np.zeros((1, len(NAMES))))
    informations: Array = field(default_factory=lambda: np.zeros((1, len(NAMES), len(NAMES))))
    length: int = 1
    last: int = 0

    @property
    def score(self) -> Array:
        """s, shape (3,)."""
        return np.asarray(self.scores.sum(axis=0))

    @property
    def information(self) -> Array:
        """I, shape (3, 3)."""
        return np.asarray(self.informations.sum(axis=0))

    def updated(
        self, bias_rows: Array, innovation: Array, cov: Array, scale_jacobian: float
    ) -> "BiasScore":
        """Return the score after a profile.

        Args:
            bias_rows: shape (m, 3), effect of an error of one unit on the innovation.
            innovation: shape (m,), of the rows.
            cov: shape (m, m), its covariance.
            scale_jacobian: Of the profile; see ``scale_jacobian``.
        """
        products = bias_rows.T @ np.linalg.solve(cov, np.column_stack([innovation, bias_rows]))
        score, information = products[:, 0], products[:, 1:]
        score[NAMES.index("scale")] -= scale_jacobian
        if self.last < self.length:
            scores, informations = self.scores.copy(), self.informations.copy()
            scores[-1] += score
            informations[-1] += information
            return BiasScore(scores, informations, self.length, self.last + 1)
        if len(self.scores) < _PARTS:
            return BiasScore(
                np.vstack([self.scores, score]),
                np.concatenate([self.informations, information[None]]),
                self.length,
                1,
            )
        scores, informations = (
            v.reshape(_PARTS // 2, 2, *v.shape[1:]).sum(axis=1)
            for v in (self.scores, self.informations)
        )
        return BiasScore(
            np.vstack([scores, score]),
            np.concatenate([informations, information[None]]),
            2 * self.length,
            1,
        )

    def significant(self) -> dict[str, tuple[float, float]]:
        """Return the significant errors, all estimated together: estimate and standard deviation; rad, 1, 1/s.

        Together, because a scale error alone looks a little like a shear error: both are along the motion through water.
        """
        if not np.diag(self.information).all():
            return {}
        cov = np.linalg.pinv(self.information, hermitian=True)
        estimates, stds = cov @ self.score, np.sqrt(np.diag(cov))
        if len(self.scores) >= _LEAST_PARTS:
            # residual of each part's score at the joint estimate
            residual = (self.scores - self.informations @ estimates) @ cov
            stds = np.maximum(
                stds,
                np.sqrt(len(residual) / (len(residual) - len(NAMES)) * np.sum(residual**2, axis=0)),
            )
        return {
            name: (float(estimate), float(std))
            for name, estimate, std, harmless in zip(NAMES, estimates, stds, _HARMLESS, strict=True)
            if abs(estimate) > max(_SIGNIFICANT * std, harmless)
        }


_UNITS = Biases(NAMES, np.ones(len(NAMES)))


def unit_bias_rows(
    screened: Screened, projection: Projection, bins: Bins, innovation: Array
) -> Array | None:
    """Return the effect of an error of one unit on an observation's rows, shape (m, 3); None where the log lacks the platform's motion.

    Args:
        screened: The observation; a mean along a path has no information on the instrument.
        projection: Of the local axes.
        bins: Rows of its usable bins.
        innovation: shape (n, 2) [m/s], of the usable bins, measured minus predicted.
    """
    observation, used = screened.observation, screened.used
    relative = (
        None
        if isinstance(observation, PathMean)
        else relative_velocity(observation, used, projection)
    )
    if relative is None:
        return None
    columns = _UNITS.columns(screened.unused.depth[used], relative, innovation)
    return np.stack([bins.compress(column)[0] for column in columns], axis=1)


def scale_jacobian(observation: Measurement, bins: Bins, innovation: Array, cov: Array) -> float:
    """Return the derivative of the log-density's Jacobian with respect to a scale error, at zero: to be subtracted from its score.

    With sound error statements the regressor contains, on average, one unit of the innovation for each component, less the share of the
    platform velocity's error, which is in the innovation alone. The result is scaled by the innovation's own normalised square, because
    errors are often overstated.

    Args:
        observation: The profile.
        bins: Rows of its usable bins.
        innovation: shape (m,), of the rows.
        cov: shape (m, m), covariance of the rows' innovation.
    """
    if (
        isinstance(observation, PathMean)
        or observation.platform_velocity is None
        or not np.isfinite(observation.common_std)
    ):
        return 0.0
    rows = np.column_stack(
        [bins.compress(np.broadcast_to(component, bins.values.shape))[0] for component in np.eye(2)]
    )
    shared = observation.common_std**2 * np.sum(rows * np.linalg.solve(cov, rows))
    return float((2.0 - shared) * normalised_square(innovation, cov)[0] / innovation.size)


def in_words(name: str, estimate: float, std: float) -> str:
    """Return a bias as text for people."""
    if name == "heading":
        return f"heading {np.rad2deg(estimate):+.1f} +- {np.rad2deg(std):.1f} degrees"
    if name == "scale":
        return f"scale {1e2 * estimate:+.1f} +- {1e2 * std:.1f} %"
    return f"shear {1e3 * estimate:+.2f} +- {1e3 * std:.2f} mm/s a metre"


def notes_of(biases: dict[str, tuple[float, float]]) -> str:
    """Return biases, each with its standard deviation, as text for people."""
    return ", ".join(in_words(name, *value) for name, value in biases.items())


def significant_bias_notes(score: BiasScore, estimated: tuple[str, ...] = ()) -> list[str]:
    """Return a note on the significant errors that are not part of the state.

    Args:
        score: Of the log so far.
        estimated: Names of the errors that are part of the state.
    """
    found = {name: value for name, value in score.significant().items() if name not in estimated}
    if not found:
        return []
    names = ", ".join(f'"{name}"' for name in found)
    return [
        f"the log shows systematic errors of the instrument: {notes_of(found)}; time.biases = [{names}] estimates them"
    ]
