"""The estimator through time: its estimate changes between observations."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.linalg import solve_triangular

from replay_kit.config.estimation import GatingConfig
from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.flow.evolution import Evolution
from replay_kit.core.flow.local import Oscillation
from replay_kit.core.grid import Grid
from replay_kit.core.observation import Innovation, Measurement
from replay_kit.estimator.basis.modes import Basis
from replay_kit.estimator.evolving.observation_operator import ObservationOperator, column_operator
from replay_kit.estimator.evolving.state_space import EvolvingState, StateSpace
from replay_kit.estimator.update.biases import (
    NAMES,
    notes_of,
)
from replay_kit.estimator.update.group_step import GroupColumn, GroupedEstimator, group_misfit
from replay_kit.estimator.update.grouping import Grouping
from replay_kit.estimator.update.screening import ScreenedGroup
from replay_kit.estimator.update.stack import Stack
from replay_kit.estimator.update.superobservation import Column, ColumnUpdate, CombinedRows

_NS = 1e9
# Observations late by no more count at the state's time: pings wait for the position after them, other measurements do not.
_LATE_NS = 1_200_000_000_000
# Share of a bias's prior standard deviation above which the log has no information on it.
_UNOBSERVED = 0.95


@dataclass(frozen=True, slots=True, eq=False)
class EvolvingEstimator(GroupedEstimator[EvolvingState]):
    """The default estimate through time.

    Attributes:
        operator: Maps the state to observations.
        state_space: The unknowns and their evolution.
        gating: Gate and covariance inflation; None accepts every observation with its stated errors.
        time_ns: Of the estimate before any observation [ns, UTC].
        grouping: Which profiles are combined; None combines none.
    """

    operator: ObservationOperator
    state_space: StateSpace
    gating: GatingConfig | None
    time_ns: int | None
    grouping: Grouping | None = None

    supports_path_means = True

    @property
    def grid(self) -> Grid:
        """The grid of the forecast."""
        return self.basis.grid

    @property
    def basis(self) -> Basis:
        """Basis flows."""
        return self.operator.basis

    @property
    def state_size(self) -> int:
        """Number of unknowns."""
        return self.state_space.size

    def initial(self) -> EvolvingState:
        """Return the state before any observation."""
        size = self.state_space.size
        return EvolvingState(np.zeros((size, 1 + len(NAMES))), np.eye(size))

    def predict(self, state: EvolvingState, time_ns: int) -> EvolvingState:
        """Return the state at a later time without observations in between, with larger uncertainty; unchanged for an earlier time."""
        if state.time_ns is None:
            return replace(state, time_ns=time_ns)
        time_ns = max(time_ns, state.time_ns)
        means, cov = self.state_space.predict(
            state.means, state.cov, (time_ns - state.time_ns) / _NS
        )
        return replace(state, means=means, cov=cov, time_ns=time_ns)

    def step(
        self, state: EvolvingState, observation: Measurement
    ) -> tuple[EvolvingState, Innovation]:
        """Return the state after an observation, and the innovation.

        An observation without a usable bin, older than the state by more than twenty minutes, or equal to the one before leaves the state
        unchanged.
        """
        screened = self.screened(state, (observation,))
        if not screened.used.size:
            return state, screened.unused(0)
        (stepped,) = self.step_screened(state, screened)
        return stepped.after, stepped.innovation

    def group_column(self, state: EvolvingState, screened: ScreenedGroup) -> "EvolvingColumn":
        """Return the estimate of the column that the usable measurements see, at their mean time."""
        operator = column_operator(self.operator, screened)
        at_time, design = self.predict(state, operator.time_ns), operator.design
        cross = design @ at_time.cov
        cov = cross @ design.T

        def posterior(step: ColumnUpdate) -> tuple[Array, Array]:
            gain = solve_triangular(step.lower, rows_in(cross, step.rows), lower=True)
            return at_time.means + gain.T @ step.whitened, at_time.cov - gain.T @ gain

        def against(other: EvolvingState) -> Array:
            return group_misfit(operator.stack, design @ self._mean_at(other, operator.time_ns))

        column, prior = Column(design @ at_time.means, 0.5 * (cov + cov.T)), np.zeros(len(design))
        return EvolvingColumn(
            operator.stack, at_time, column, prior, posterior, against, design=design
        )

    def group_mean(self, state: EvolvingState, screened: ScreenedGroup) -> tuple[Stack, Array]:
        """Return the usable measurements, and the mean of their column at their mean time, shape (c q,)."""
        operator = column_operator(self.operator, screened)
        return operator.stack, operator.design @ self._mean_at(state, operator.time_ns)

    def with_posterior(
        self, at: GroupColumn[EvolvingState], posterior: tuple[Array, Array], jacobian: float
    ) -> EvolvingState:
        """Return the state after measurements."""
        means, cov = posterior
        return replace(at.state, means=self.with_scale_jacobian(means, cov, jacobian), cov=cov)

    def inflated(self, state: EvolvingState, factor: float) -> EvolvingState:
        """Return a state whose covariance is multiplied by a factor."""
        return state if factor == 1.0 else replace(state, cov=factor * state.cov)

    def _mean_at(self, state: EvolvingState, time_ns: int) -> Array:
        """Return the mean of the unknowns, shape (n,), at a time; an earlier one counts as the state's."""
        seconds = 0.0 if state.time_ns is None else max(time_ns - state.time_ns, 0) / _NS
        return self.state_space.predict_mean(state.mean, seconds)

    def is_late(self, state: EvolvingState, time_ns: int) -> bool:
        """Return whether an observation of a time is too old for a state."""
        return state.time_ns is not None and time_ns < state.time_ns - _LATE_NS

    def with_scale_jacobian(self, means: Array, cov: Array, jacobian: float) -> Array:
        """Return means after the Jacobian of a scale error, where one is estimated; see ``biases.scale_jacobian``."""
        if self._scale is None:
            return means
        position, std = self._scale
        out = means.copy()
        out[:, 0] -= cov[:, position] * std * jacobian
        return out

    def jacobian_gradient(self, jacobian: float) -> Array:
        """Return the gradient in the unknowns, shape (n,), that ``with_scale_jacobian`` subtracts from that of the log-density."""
        out = np.zeros(self.state_space.size)
        if self._scale is not None:
            position, std = self._scale
            out[position] = std * jacobian
        return out

    @property
    def _scale(self) -> tuple[int, float] | None:
        """Position of the scale error among the unknowns, and its prior standard deviation; None where none is estimated."""
        biases = self.operator.biases
        if "scale" not in biases.names:
            return None
        k = biases.names.index("scale")
        return self.state_space.parts["biases"].start + k, float(biases.std[k])

    def weights(self, states: Sequence[EvolvingState]) -> Sequence[Array | None]:
        """Return the means of the weights at the states' times, each of shape (Z r,)."""
        return [self._weights(state) for state in states]

    def _weights(self, state: EvolvingState) -> Array:
        process = self.operator.process
        return process.weights(state.mean[: process.size], self._time(state)).ravel()

    def biases(self, state: EvolvingState) -> dict[str, tuple[float, float]]:
        """Return each estimated bias of the instrument, with its standard deviation: rad, 1, 1/s."""
        part, biases = self.state_space.parts["biases"], self.operator.biases
        values = zip(
            biases.std * state.mean[part],
            biases.std * np.sqrt(np.diag(state.cov)[part]),
            strict=True,
        )
        return {
            name: (float(mean), float(std))
            for name, (mean, std) in zip(biases.names, values, strict=True)
        }

    def flow(self, state: EvolvingState) -> FlowEstimate:
        """Return the current estimate of a state, at its time, without oscillations; its covariance is computed when first asked for.

        Its model of time knows what oscillates.
        """
        basis, process = self.basis, self.operator.process
        part = slice(0, process.size)
        evolution = Evolution(
            process,
            basis.offset,
            state.mean[part],
            lambda: state.cov[part, part],
            state.time_ns,
            self._oscillation(state),
        )
        still = FlowEstimate(
            basis.grid,
            basis.horizontal,
            basis.depth_functions,
            basis.offset,
            basis.modes,
            np.empty((0, 0)),
            None,
        )
        flow = evolution.flow(still, self._time(state))
        return (
            replace(flow, time_ns=None) if state.time_ns is None and self.time_ns is None else flow
        )

    def _oscillation(self, state: EvolvingState) -> Oscillation | None:
        part = self.state_space.parts["oscillations"]
        if state.time_ns is None or part.start == part.stop:
            return None
        scale = float(self.state_space.scales[part.start])
        return self.operator.oscillations.known(
            state.mean[part], self.basis.grid.levels, scale, state.time_ns
        )

    @property
    def basis_size(self) -> tuple[int | None, int | None]:
        """Number of modes for each level, and of elements of the basis."""
        return self.basis.n_modes, self.basis.modes.size

    def notes(self) -> list[str]:
        """Return the time scales of the process model."""
        return [f"through time: {self.operator.process}"]

    def bias_notes(self, state: EvolvingState) -> list[str]:
        """Return the estimated systematic errors of the instrument."""
        biases, values, notes = self.operator.biases, self.biases(state), []
        observed = {
            name: values[name]
            for name, std in zip(biases.names, biases.std, strict=True)
            if values[name][1] < _UNOBSERVED * std
        }
        if observed:
            notes.append(f"systematic errors of the instrument, estimated: {notes_of(observed)}")
        if missing := [name for name in biases.names if name not in observed]:
            notes.append(
                f"the log has no information on errors in {', '.join(missing)}: too few profiles state the platform's motion"
            )
        return notes

    def _time(self, state: EvolvingState) -> int:
        at = self.time_ns if state.time_ns is None else state.time_ns
        return int(self.operator.process.times_ns[0]) if at is None else at


@dataclass(frozen=True, slots=True, eq=False)
class EvolvingColumn(GroupColumn[EvolvingState]):
    """A column of unknowns of the state.

    Attributes:
        design: shape (c q, n), from the state to the column's unknowns.
    """

    design: Array = field(kw_only=True)


def rows_in(design: Array, rows: CombinedRows) -> Array:
    """Return combined rows of a column's unknowns, whose ``design`` has the shape (c q, n), as rows of the state's, in the same shape."""
    by_component = np.matmul(rows.r, design.reshape(-1, len(rows.r), design.shape[1]))
    return np.asarray(by_component.reshape(design.shape))
