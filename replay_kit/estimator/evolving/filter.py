"""The estimator whose estimate changes between observations: state in, observation in; state and innovation out."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from replay_kit.config.gating import TrustConfig
from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.observation import Innovation, Observation, PathMean, Reason
from replay_kit.estimator.basis.modes import Basis
from replay_kit.estimator.evolving.seen import Model, Seen
from replay_kit.estimator.evolving.state import Layout, look_along
from replay_kit.estimator.evolving.together import Group
from replay_kit.estimator.update.biases import NAMES, Evidence, stretch, unit_columns
from replay_kit.estimator.update.gate import Watch
from replay_kit.estimator.update.observation import Looked, look_at
from replay_kit.estimator.update.screening import as_profile, is_repeated, rejected, repeated, scatter, screen, usable

_NS = 1e9
# What comes late by no more counts at the state's time: pings wait for the position after them, other measurements do not.
_LATE_NS = 1_200_000_000_000
_NO_EVIDENCE_YET = Evidence()


@dataclass(frozen=True, slots=True, eq=False)
class EvolvingState:
    """What is known at one time.

    Attributes:
        means: shape (n, 4): of the unknowns, and how it answers to a heading, scale and shear error of one unit that no unknown stands for.
        covariance: shape (n, n), or the group that it is computed from when first asked for; read ``cov``.
        time_ns: For which the last observation used counts [ns, UTC], the first of its group where several count together; None before
            the first.
        watch: Over the latest verdicts.
        last: Observation offered last.
        evidence: Of errors of the instrument.
        group: Profiles that the next one may count together with; None without. Whoever changes means or covariance ends it.
    """

    means: Array
    covariance: Array | Group
    time_ns: int | None
    watch: Watch
    last: Observation | PathMean | None = None
    evidence: Evidence = _NO_EVIDENCE_YET
    group: Group | None = None

    @property
    def cov(self) -> Array:
        """Covariance of the unknowns, shape (n, n)."""
        return self.covariance.cov if isinstance(self.covariance, Group) else self.covariance

    @property
    def mean(self) -> Array:
        """Mean of the unknowns, shape (n,)."""
        return self.means[:, 0]


@dataclass(frozen=True, slots=True, eq=False)
class EvolvingEstimator:
    """The default estimate through time.

    Attributes:
        model: What observations see.
        layout: The unknowns and how they change.
        trust: Gate and watch; None believes every observation as it is.
        time_ns: Of the estimate before any observation [ns, UTC].
        window: Profiles within so long count together [s].
    """

    model: Model
    layout: Layout
    trust: TrustConfig | None
    time_ns: int | None
    window: float = 0.0

    takes_paths = True

    @property
    def basis(self) -> Basis:
        """Basis flows."""
        return self.model.basis

    @property
    def state_size(self) -> int:
        """Number of unknowns."""
        return self.layout.size

    def initial(self) -> EvolvingState:
        """Return the state before any observation."""
        return EvolvingState(np.zeros((self.layout.size, 1 + len(NAMES))), np.eye(self.layout.size), None, Watch())

    def steps(self, state: EvolvingState, observations: Iterable[Observation | PathMean]) -> Iterator[tuple[EvolvingState, Innovation]]:
        """Yield the state after each observation, and what it said: ``step`` over and over."""
        for observation in observations:
            state, innovation = self.step(state, observation)
            yield state, innovation

    def step(self, state: EvolvingState, observation: Observation | PathMean) -> tuple[EvolvingState, Innovation]:
        """Return the state after an observation, and the innovation.

        An observation without a usable bin, older than the state by more than twenty minutes, or the same as the one before, leaves the
        state untouched. Profiles in one window count together: all are compared with the state before the first, which alone is watched.
        """
        group = state.group if state.group is not None and state.group.takes(observation, self.window) else None
        offered = self.offered(state, observation, None if group is None else group.before)
        if isinstance(offered, Innovation):
            return state, offered
        if group is not None:
            return self._joined(state, group, offered)
        after, innovation = self.taken(state, offered)
        if self.window > 0.0 and isinstance(observation, Observation):
            after = replace(after, group=self._opened(after, offered, innovation.prior_inflation))
        return after, innovation

    def _opened(self, after: EvolvingState, offered: "Offered", grown: float) -> Group:
        """Return the group that a profile begins; ``after`` is the state with it."""
        # a rejected profile leaves the state where it was; those that count with it are held against the state at its time all the same
        believed, time_ns = offered.looked.believed, offered.observation.time_ns
        before = offered.before if believed else self.predicted(after, time_ns)
        group = Group.opened(time_ns, before, grown if believed else 1.0)
        return group.with_profile(*offered.rows) if believed else group

    def _joined(self, state: EvolvingState, group: Group, offered: "Offered") -> tuple[EvolvingState, Innovation]:
        """Return the state after one more profile of a group, and the innovation."""
        looked = offered.looked
        said = looked.said(offered.said, offered.used, np.zeros(len(offered.seen.design)), 1.0)
        if not looked.believed:
            return replace(state, last=offered.observation), said
        group = group.with_profile(*offered.rows)
        means = self._stretched(group.means, group.cov_column, group.stretched)
        time_ns, evidence = group.before.time_ns, group.evidence
        return EvolvingState(means, group, time_ns, state.watch, offered.observation, evidence, group), said

    def offered(
        self, state: EvolvingState, observation: Observation | PathMean, before: EvolvingState | None = None
    ) -> "Offered | Innovation":
        """Return an observation looked at, or what is said of one that cannot be used.

        Args:
            state: The state so far.
            observation: What is offered to it.
            before: The state at the time for which the observation counts; None for its own time.
        """
        whole = as_profile(observation)
        flags, reasons = screen(whole, self.model.basis.grid, relative=True)
        said = rejected(whole, flags, reasons)
        used = np.flatnonzero(usable(flags))
        if used.size == 0:
            return said
        if state.time_ns is not None and observation.time_ns < state.time_ns - _LATE_NS:
            return repeated(said, Reason.OUT_OF_ORDER)
        if is_repeated(state.last, observation):
            return repeated(said, Reason.DUPLICATE)
        seen = self.model.path(observation) if isinstance(observation, PathMean) else self.model.profile(observation, used)
        before = before or self.predicted(state, observation.time_ns)
        look = look_along(before.means, before.cov, seen.design)
        looked = look_at(seen, seen.values, look, self.trust, True, before.watch.settled)
        columns = unit_columns(observation, used, self.basis.grid.projection, seen, seen.misfit(seen.values, look.mean))
        return Offered(observation, before, seen, looked, look.cross, columns, said, used)

    def taken(self, state: EvolvingState, offered: "Offered") -> tuple[EvolvingState, Innovation]:
        """Return the state after an observation that was offered to a state, and the innovation."""
        looked, after = offered.looked, state
        if looked.believed:
            means, cov = looked.look.posterior(offered.told, looked.error_scale)
            means = self._stretched(means, lambda position: cov[:, position], offered.stretched)
            after = replace(offered.before, means=means, covariance=cov)
        return self._noted(after, offered)

    def _noted(self, after: EvolvingState, offered: "Offered") -> tuple[EvolvingState, Innovation]:
        """Return a state with what an observation said noted, its covariance grown where the watch asks for it, and the innovation."""
        looked = offered.looked
        watch, grown = after.watch.after(looked.verdict, self.trust)
        evidence = looked.evidence(after.evidence, offered.observation, offered.columns)
        covariance = after.covariance if grown == 1.0 else grown * after.cov
        after = replace(after, covariance=covariance, watch=watch, last=offered.observation, evidence=evidence, group=None)
        return after, looked.said(offered.said, offered.used, np.zeros(len(offered.seen.design)), grown)

    def _stretched(self, means: Array, cov_column: Callable[[int], Array], stretched: float) -> Array:
        """Return means with the stretching of what a scale error measures taken off, where one is estimated; see ``biases``."""
        names = self.model.biases.names
        if "scale" not in names:
            return means
        at = self.layout.parts["biases"].start + names.index("scale")
        out = means.copy()
        out[:, 0] -= cov_column(at) * float(self.model.biases.std[names.index("scale")]) * stretched
        return out

    def predicted(self, state: EvolvingState, time_ns: int) -> EvolvingState:
        """Return the state at a later time without observations in between, of which less is known; as it is for an earlier one."""
        if state.time_ns is None:
            return replace(state, time_ns=time_ns, group=None)
        time_ns = max(time_ns, state.time_ns)
        means, cov = self.layout.predict(state.means, state.cov, (time_ns - state.time_ns) / _NS)
        return replace(state, means=means, covariance=cov, time_ns=time_ns, group=None)

    def usable(self, observation: Observation | PathMean) -> bool:
        """Return whether an observation has a bin that ``step`` would use."""
        flags, _ = screen(as_profile(observation), self.model.basis.grid, relative=True)
        return bool(np.any(usable(flags)))

    def misfit(self, state: EvolvingState, observation: Observation | PathMean) -> Array:
        """Return measured minus predicted by a state for the observation's time, shape (n, 2) [m/s], local axes; NaN where not usable."""
        whole = as_profile(observation)
        flags, _ = screen(whole, self.model.basis.grid, relative=True)
        used = np.flatnonzero(usable(flags))
        if used.size == 0:
            return np.full((whole.depth.size, 2), np.nan)
        seen = self.model.path(observation) if isinstance(observation, PathMean) else self.model.profile(observation, used)
        at = observation.time_ns if state.time_ns is None else max(observation.time_ns, state.time_ns)
        mean = self.layout.forecast_mean(state.mean, 0.0 if state.time_ns is None else (at - state.time_ns) / _NS)
        return scatter(whole.depth.size, used, seen.misfit(seen.values, seen.design @ mean))

    def weights(self, state: EvolvingState) -> Array:
        """Return the mean of the weights at the state's time, shape (Z r,)."""
        sea = self.model.sea
        return sea.weights(state.mean[: sea.size], self._time(state)).ravel()

    def biases(self, state: EvolvingState) -> dict[str, tuple[float, float]]:
        """Return each bias of the instrument that is estimated, with its standard deviation: rad, 1, 1/s."""
        part, of = self.layout.parts["biases"], self.model.biases
        std = np.sqrt(np.diag(state.cov)[part])
        return {
            name: (float(unit * mean), float(unit * one))
            for name, unit, mean, one in zip(of.names, of.std, state.mean[part], std, strict=True)
        }

    def at(self, state: EvolvingState, time_ns: int) -> FlowEstimate:
        """Return the current estimate for a time: that of the state if it is not later.

        Oscillations are no part of it: it is what stays when they are taken off.
        """
        return self.flow(self.predicted(state, time_ns))

    def flow(self, state: EvolvingState) -> FlowEstimate:
        """Return the current estimate that a state stands for, at its time; its covariance is computed when first asked for."""
        basis, sea, at = self.model.basis, self.model.sea, self._time(state)

        @cache
        def covariance(levels: tuple[int, ...] | None) -> Array:
            loading = sea.loading(at)[:, slice(None) if levels is None else list(levels)].reshape(sea.size, -1)
            return np.asarray(loading.T @ state.cov[: sea.size, : sea.size] @ loading)

        latent = basis.offset + basis.modes @ self.weights(state).reshape(basis.grid.levels.size, -1).T
        known = None if state.time_ns is None and self.time_ns is None else at
        return FlowEstimate(
            basis.grid, basis.kernel, basis.depth_functions, latent, basis.modes, covariance, known, lambda time_ns: self.at(state, time_ns)
        )

    def _time(self, state: EvolvingState) -> int:
        at = self.time_ns if state.time_ns is None else state.time_ns
        return int(self.model.sea.times_ns[0]) if at is None else at


@dataclass(frozen=True, slots=True, eq=False)
class Offered:
    """An observation looked at.

    Attributes:
        observation: As it came.
        before: The state at its time.
        seen: Its rows.
        looked: What was made of them.
        cross: shape (m, n), the rows times the covariance of the state at its time.
        columns: shape (m, 3), what errors of the instrument of one unit do to them; None where the log does not say.
        said: What is said of it before.
        used: Positions of its usable bins.
    """

    observation: Observation | PathMean
    before: EvolvingState
    seen: Seen
    looked: Looked[tuple[Array, Array]]
    cross: Array
    columns: Array | None
    said: Innovation
    used: NDArray[np.intp]

    @property
    def told(self) -> Array:
        """Innovations, shape (m, 4): of the rows, and of each error of one unit."""
        return self.looked.look.told(self.looked.innovation, self.columns)

    @property
    def rows(self) -> tuple[Array, Array, Array, float, bool]:
        """What a group takes of a believed profile; see ``Group``."""
        scale = self.looked.error_scale
        return self.seen.design / scale, self.cross / scale, self.told / scale, self.stretched, self.columns is not None

    @property
    def stretched(self) -> float:
        """Of the observation; see ``biases.stretch``."""
        if self.columns is None or not self.looked.believed:
            return 0.0
        return stretch(self.observation, self.used.size, self.seen, self.looked.innovation, self.looked.innovation_cov)
