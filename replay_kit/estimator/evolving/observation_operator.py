"""The observation operator: rows of unit noise for profiles and for means along a path, oscillations and instrument biases included.

At a place each unknown of the process model gives a current level by level, S_c (Z x n) for component c, which the hat functions D
interpolate to the bins; oscillations have depth functions of their own, D_o, and biases are proportional to the velocity relative to the
platform. So a component's design is

    [D S_c | D_o O_c | M B_c] = J F_c,    J = [D | D_o | M],

with one depth factor J for both components, which a QR factorisation compresses as in ``update/rows.py``.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from replay_kit.config.estimation import TimeConfig
from replay_kit.core.arrays import Array
from replay_kit.core.flow.evolution import ProcessModel
from replay_kit.core.flow.functions import DepthFunctions, depth_weights
from replay_kit.core.flow.local import Oscillation
from replay_kit.core.geodesy import to_local
from replay_kit.core.observation import LinearMeasurement, Measurement
from replay_kit.estimator.basis.modes import Basis
from replay_kit.estimator.update.biases import Biases
from replay_kit.estimator.update.group_step import stack_of
from replay_kit.estimator.update.grouping import mean_time
from replay_kit.estimator.update.noise import BinNoise, compress, measurement_noise
from replay_kit.estimator.update.rows import places_of
from replay_kit.estimator.update.screening import (
    ScreenedGroup,
    local_values,
    relative_velocities,
)
from replay_kit.estimator.update.stack import Stack, stack_of_one

# rad/s; the Earth's rotation, and the tides of Doodson (1921) as the IHO's list of constituents gives them, degrees an hour
EARTH_ROTATION = 7.292115e-5
_TIDES = {"M2": 28.9841042, "S2": 30.0, "K1": 15.0410686, "O1": 13.9430356}
# Knots of an oscillation in each of its depth lengths.
_KNOTS_A_LENGTH = 2


@dataclass(frozen=True, slots=True, eq=False)
class Oscillations:
    """Horizontally uniform currents that oscillate at a known frequency, each with a depth structure of its own.

    A near-inertial one rotates as a vector, clockwise in the north: one pair, (east, north). A tide has an ellipse: a pair for each
    component, of which the first is the current now and the second its value a quarter period later.

    Attributes:
        knots: shape (K,) [m], depths between which an oscillation is linear; empty without oscillations.
        root: shape (K, K) [m/s], maps independent unknowns to the knots.
        omega: shape (q,), of each pair [rad/s].
        inertial: shape (q,), whether the pair is (east, north) of a rotating one.
        component: shape (q,), of a tide's pair: 0 east, 1 north.
    """

    knots: Array
    root: Array
    omega: Array
    inertial: Sequence[bool]
    component: Sequence[int]

    @property
    def size(self) -> int:
        """Number of unknowns: two for each pair and knot."""
        return 2 * self.omega.size * self.knots.size

    def weights(self, depth: Array) -> Array:
        """Return hat functions of the knots at depths, shape (n, K)."""
        if self.knots.size == 0:
            return np.empty((depth.size, 0))
        return depth_weights(DepthFunctions("hat", 1.0), depth, self.knots)

    def factor(self, component: int) -> Array:
        """Return the effect of one unit of each unknown on a component at the knots, shape (K, size) [m/s]; pair after pair."""
        nothing = np.zeros_like(self.root)
        blocks: list[Array] = []
        for inertial, of_pair in zip(self.inertial, self.component, strict=True):
            if inertial:
                blocks += [self.root, nothing] if component == 0 else [nothing, self.root]
            else:
                blocks += [self.root if component == of_pair else nothing, nothing]
        return np.hstack(blocks) if blocks else np.empty((self.knots.size, 0))

    def known(
        self, unknowns: Array, levels: Array, scale: float, time_ns: int
    ) -> Oscillation | None:
        """Return what oscillates as later times need it; None where nothing does. Steady currents are no part of it.

        Args:
            unknowns: shape (size,), their means.
            levels: shape (Z,) [m].
            scale: Time over which the phase is forgotten [s].
            time_ns: Of the unknowns [ns, UTC].
        """
        turning = np.flatnonzero(self.omega)
        if turning.size == 0 or self.knots.size == 0:
            return None
        now = unknowns.reshape(self.omega.size, 2, self.knots.size)
        quarter_later = np.stack([now[:, 1], -now[:, 0]], axis=1)
        at_levels, factors = (
            self.weights(levels),
            [self.factor(c).reshape(self.knots.size, self.omega.size, 2, -1) for c in (0, 1)],
        )
        cosine, sine = (
            np.stack(
                [np.einsum("zk,kqpj,qpj->qz", at_levels, factor, each) for factor in factors],
                axis=1,
            )
            for each in (now, quarter_later)
        )
        return Oscillation(self.omega[turning], cosine[turning], sine[turning], scale, time_ns)

    def at(self, rows: Array, seconds: Array) -> Array:
        """Return rows, shape (P, size), for unknowns given at other times, ``seconds``, shape (P,), later when negative."""
        pairs = rows.reshape(len(rows), self.omega.size, 2, self.knots.size)
        angle = np.multiply.outer(seconds, self.omega)[..., None]
        cosine, sine = np.cos(angle), np.sin(angle)
        # x(t + s) = R(s) x(t), so h x(t + s) = (R(s)' h) x(t)
        first, second = pairs[:, :, 0], pairs[:, :, 1]
        turned = [cosine * first - sine * second, sine * first + cosine * second]
        return np.stack(turned, axis=2).reshape(rows.shape)


def oscillations(config: TimeConfig, latitude: float, deepest: float) -> Oscillations:
    """Return the configured oscillations.

    Args:
        config: Names, standard deviations and correlation lengths in depth.
        latitude: Of the region's centre [degrees north], for the inertial frequency.
        deepest: [m].
    """
    omega: list[float] = []
    inertial: list[bool] = []
    component: list[int] = []
    for name in config.oscillators:
        if name == "inertial":
            omega.append(2.0 * EARTH_ROTATION * np.sin(np.deg2rad(latitude)))
            inertial.append(True)
            component.append(0)
        else:
            omega += [np.deg2rad(_TIDES[name]) / 3600.0] * 2
            inertial += [False, False]
            component += [0, 1]
    length = config.oscillator_depth_length
    n_knots = max(2, int(np.ceil(_KNOTS_A_LENGTH * deepest / length)) + 1) if omega else 0
    knots = np.linspace(0.0, deepest, n_knots)
    correlation = np.exp(-0.5 * ((knots[:, None] - knots) / length) ** 2) + 1e-9 * np.eye(n_knots)
    root = np.asarray(config.oscillator_std * np.linalg.cholesky(correlation), dtype=np.float64)
    return Oscillations(knots, root, np.array(omega), inertial, component)


def biases(config: TimeConfig) -> Biases:
    """Return the configured biases."""
    std = {
        "heading": np.deg2rad(config.heading_bias_std),
        "scale": config.scale_bias_std,
        "shear": config.shear_bias_std,
    }
    return Biases(
        tuple(config.biases), np.array([std[name] for name in config.biases], dtype=np.float64)
    )


_NS = 1e9


@dataclass(frozen=True, slots=True, eq=False)
class ObservationOperator:
    """The map from the state to observations.

    Attributes:
        basis: Basis flows.
        process: The weights' prior through time.
        oscillations: Uniform over the region.
        biases: Of the instrument.
        representation_std: shape (Z,) [m/s], representation error of the basis, by level.
    """

    basis: Basis
    process: ProcessModel
    oscillations: Oscillations
    biases: Biases
    representation_std: Array

    def current(self, place: Array, time_ns: int) -> tuple[Array, Array]:
        """Return the current at a place level by level: without the unknowns, shape (Z, 2), and of each of them, (F + B, Z, 2) [m/s]."""
        offset, modes = self.basis.at_place(place)
        known = offset.T + self.process.mean_at(time_ns) @ modes.T
        return known, self.process.project(modes, time_ns)

    def column(self, place: Array, time_ns: int, relative: Array | None) -> tuple[Array, Array]:
        """Return the column of water at a place and time, and what its unknowns are of the state's.

        Args:
            place: shape (2,) [m], local east and north.
            time_ns: [ns, UTC].
            relative: shape (2,) [m/s], mean velocity relative to the platform; None where it is not stated.

        Returns:
            The current of unknowns that are all zero, shape (Z, 2) [m/s], and F, shape (2, q, n), see the module.
        """
        known, unknown = self.current(place, time_ns)
        blocks = (
            unknown.transpose(2, 1, 0),
            np.stack([self.oscillations.factor(c) for c in range(2)]),
            self.biases.factor(relative),
        )
        _, height, width = np.sum([block.shape for block in blocks], axis=0)
        design, row, column = np.zeros((2, height, width)), 0, 0
        for block in blocks:
            _, n_rows, n_columns = block.shape
            design[:, row : row + n_rows, column : column + n_columns] = block
            row, column = row + n_rows, column + n_columns
        return known, design

    def joint(self, depth: Array) -> Array:
        """Return J, the depth functions of a column's unknowns, shape (n, q)."""
        return np.hstack(
            [
                self.basis.depth_weights(depth),
                self.oscillations.weights(depth),
                self.biases.functions(depth),
            ]
        )

    def path(self, observation: Measurement, used: NDArray[np.intp]) -> "ColumnOperator":
        """Return a measurement's usable values, sums over several places, and their rows: each point counts at its own time.

        The unknowns are those at the measurement's time. Pairs are rotated back to each point's; process noise in between is neglected.
        """
        mean, grid, process = observation.linear, self.basis.grid, self.process
        places = places_of(mean, grid.projection)
        assert mean.weights is not None, "each value is a sum over places"
        velocity = self.basis.horizontal.velocity
        modes, offset = velocity(places, self.basis.modes), velocity(places, self.basis.offset)
        stated = mean.time_ns if mean.point_time_ns is None else mean.point_time_ns
        times_ns = np.broadcast_to(stated, len(places))
        shares = process.shares(times_ns)
        back = (times_ns - mean.time_ns) / _NS
        at_levels, at_knots = (
            self.basis.depth_weights(mean.depth),
            self.oscillations.weights(mean.depth),
        )
        known, rows = [], []
        for weights in mean.weights[used]:
            levels, knots = weights[:, None] * at_levels, weights[:, None] * at_knots
            of_known, of_process = process.project_sum(levels, modes, shares)
            known.append(of_known + np.einsum("pz,cpz->c", levels, offset))
            turned = [
                self.oscillations.at(knots @ self.oscillations.factor(c), back).sum(axis=0)
                for c in range(2)
            ]
            rows.append(np.hstack([of_process.T, turned]))
        noise = measurement_noise(mean, used, self.basis, self.representation_std, places)
        values, components = local_values(mean, used, grid.projection)
        # an instrument's biases are not in it
        others = np.zeros((used.size, 2, self.biases.size))
        design = np.einsum(
            "ki,cd,idn->ckn",
            noise.whiten,
            components,
            np.concatenate([rows, others], axis=2),
            optimize=True,
        )
        about, own = (
            (values - np.array(known) @ components.T, components),
            np.eye(len(noise.whiten)),
        )
        stack = stack_of_one(mean, used, about, (noise, own, own), grid)
        return ColumnOperator(stack, design.reshape(-1, design.shape[2]), mean.time_ns)


@dataclass(frozen=True, slots=True, eq=False)
class ColumnOperator:
    """Measurements, and the unknowns of the column of water that they see.

    Attributes:
        stack: The measurements.
        design: shape (c q, n), from the state to the column's unknowns, component after component.
        time_ns: For which they count [ns, UTC].
    """

    stack: Stack
    design: Array
    time_ns: int


def column_operator(operator: ObservationOperator, screened: ScreenedGroup) -> ColumnOperator:
    """Return the usable measurements of a group, profiles at their mean place and time.

    Errors of the instrument that are part of the state act through the profiles' mean motion relative to the platform.
    """
    profiles, basis, bins = screened.usable_linear, operator.basis, screened.is_used
    first, projection = profiles[0], basis.grid.projection
    if not first.at_one_place:
        return operator.path(first, np.flatnonzero(bins[0]))
    place = np.array(to_local(projection, *screened.middle))
    time_ns = mean_time(profiles)
    relative = relative_velocities(profiles, bins, basis.grid)
    known, design = operator.column(
        place, time_ns, None if relative is None else relative.mean(axis=0)
    )

    def factors(
        profile: LinearMeasurement, used: NDArray[np.intp]
    ) -> tuple[BinNoise, Array, Array]:
        noise = measurement_noise(profile, used, basis, operator.representation_std, place[None])
        return noise, *compress(noise, profile.at_values(operator.joint(profile.depth))[used])

    stack = stack_of(screened, basis, known, factors)
    turned = np.tensordot(stack.components, design, axes=1)
    return ColumnOperator(stack, turned.reshape(-1, design.shape[2]), time_ns)
