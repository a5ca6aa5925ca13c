"""The estimator whose estimate changes between observations: state in, observation in; state and innovation out."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from replay_kit.config_trust import TrustConfig
from replay_kit.estimator.biases import NAMES, Evidence, stretch, unit_columns
from replay_kit.estimator.evolving.seen import Model, Seen
from replay_kit.estimator.evolving.state import Layout, look_along
from replay_kit.estimator.evolving.together import compressed, grouped
from replay_kit.estimator.gate import Watch
from replay_kit.estimator.looked import Looked, look_at
from replay_kit.estimator.modes import Basis
from replay_kit.estimator.screening import as_profile, is_repeated, rejected, repeated, scatter, screen, usable
from replay_kit.flow import FlowEstimate
from replay_kit.types import Array, Innovation, Observation, PathMean, Reason

_NS = 1e9
# What comes late by no more counts at the state's time: pings wait for the position after them, other measurements do not.
_LATE_NS = 1_200_000_000_000
_NO_EVIDENCE_YET = Evidence()


@dataclass(frozen=True, slots=True, eq=False)
class EvolvingState:
    """What is known at one time.

    Attributes:
        means: shape (n, 4): of the unknowns, and how it answers to a heading, scale and shear error of one unit that no unknown stands for.
        cov: shape (n, n).
        time_ns: Of the last observation used [ns, UTC]; None before the first.
        watch: Over the latest verdicts.
        last: Observation offered last.
        evidence: Of errors of the instrument.
    """

    means: Array
    cov: Array
    time_ns: int | None
    watch: Watch
    last: Observation | PathMean | None = None
    evidence: Evidence = _NO_EVIDENCE_YET

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
        """Yield the state after each observation, and what it said.

        With a window, profiles that lie in it count together: all are held against the state before the first of them, and the state
        changes with the last.
        """
        for group in grouped(observations, self.window):
            if len(group) > 1:
                done = self._together(state, group)
                state = done[-1][0]
                yield from done
            else:
                state, innovation = self.step(state, group[0])
                yield state, innovation

    def _together(self, state: EvolvingState, observations: Sequence[Observation | PathMean]) -> list[tuple[EvolvingState, Innovation]]:
        """Return the states after observations that count together, and the innovations."""
        before, current = self.predicted(state, max(observation.time_ns for observation in observations)), state
        done: list[tuple[EvolvingState, Innovation]] = []
        believed: list[Offered] = []
        for observation in observations:
            offered = self.offered(current, observation, before)
            if isinstance(offered, Innovation):
                done.append((current, offered))
                continue
            current = replace(current, last=observation)
            if offered.looked.believed:
                believed.append(offered)
            done.append((current, offered.looked.said(offered.said, offered.used, np.zeros(len(offered.seen.design)), 1.0)))
        if believed:
            design, told = compressed(
                np.concatenate([each.seen.design / each.looked.error_scale for each in believed]),
                np.concatenate([each.told / each.looked.error_scale for each in believed]),
            )
            look, stretched = look_along(before.means, before.cov, design), sum(each.stretched for each in believed)
            means, cov = look.posterior(told, 1.0)
            # held against one state, the profiles' innovations share its error: they are evidence together, and one of them is watched
            evidence = before.evidence
            if any(each.columns is not None for each in believed):
                evidence = evidence.after(told[:, 1:], told[:, 0], look.cov + np.eye(len(told)), stretched)
            watch, grown = before.watch.after(believed[0].looked.verdict, self.trust)
            means = self._stretched(means, cov, believed)
            after = replace(current, means=means, cov=grown * cov, time_ns=before.time_ns, watch=watch, evidence=evidence)
            done[-1] = after, replace(done[-1][1], prior_inflation=grown)
        return done

    def step(self, state: EvolvingState, observation: Observation | PathMean) -> tuple[EvolvingState, Innovation]:
        """Return the state after an observation, and the innovation.

        An observation without a usable bin, older than the state by more than twenty minutes, or the same as the one before, leaves the
        state untouched.
        """
        offered = self.offered(state, observation)
        return (state, offered) if isinstance(offered, Innovation) else self.taken(state, offered)

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
        looked = look_at(seen, seen.values, look, self.trust, True, state.watch.settled)
        columns = unit_columns(observation, used, self.basis.grid.projection, seen, seen.misfit(seen.values, look.mean))
        return Offered(observation, before, seen, looked, columns, said, used)

    def taken(self, state: EvolvingState, offered: "Offered") -> tuple[EvolvingState, Innovation]:
        """Return the state after an observation that was offered to a state, and the innovation."""
        looked, after = offered.looked, state
        if looked.believed:
            means, cov = looked.look.posterior(offered.told, looked.error_scale)
            after = replace(offered.before, means=self._stretched(means, cov, [offered]), cov=cov)
        return self._noted(after, offered)

    def _noted(self, after: EvolvingState, offered: "Offered") -> tuple[EvolvingState, Innovation]:
        """Return a state with what an observation said noted, its covariance grown where the watch asks for it, and the innovation."""
        looked = offered.looked
        watch, grown = after.watch.after(looked.verdict, self.trust)
        evidence = looked.evidence(after.evidence, offered.observation, offered.columns)
        cov = after.cov if grown == 1.0 else grown * after.cov
        after = replace(after, cov=cov, watch=watch, last=offered.observation, evidence=evidence)
        return after, looked.said(offered.said, offered.used, np.zeros(len(offered.seen.design)), grown)

    def _stretched(self, means: Array, cov: Array, believed: "Sequence[Offered]") -> Array:
        """Return means with the stretching of what a scale error measures taken off, where one is estimated; see ``biases``."""
        names = self.model.biases.names
        if "scale" not in names:
            return means
        stretched = sum(each.stretched for each in believed)
        at = self.layout.parts["biases"].start + names.index("scale")
        out = means.copy()
        out[:, 0] -= cov[:, at] * float(self.model.biases.std[names.index("scale")]) * stretched
        return out

    def predicted(self, state: EvolvingState, time_ns: int) -> EvolvingState:
        """Return the state at a later time without observations in between, of which less is known; as it is for an earlier one."""
        if state.time_ns is None:
            return replace(state, time_ns=time_ns)
        time_ns = max(time_ns, state.time_ns)
        means, cov = self.layout.predict(state.means, state.cov, (time_ns - state.time_ns) / _NS)
        return replace(state, means=means, cov=cov, time_ns=time_ns)

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

        def covariance() -> Array:
            loading = sea.loading(at).reshape(sea.size, -1)
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
        columns: shape (m, 3), what errors of the instrument of one unit do to them; None where the log does not say.
        said: What is said of it before.
        used: Positions of its usable bins.
    """

    observation: Observation | PathMean
    before: EvolvingState
    seen: Seen
    looked: Looked[tuple[Array, Array]]
    columns: Array | None
    said: Innovation
    used: NDArray[np.intp]

    @property
    def told(self) -> Array:
        """Innovations, shape (m, 4): of the rows, and of each error of one unit."""
        return self.looked.look.told(self.looked.innovation, self.columns)

    @property
    def stretched(self) -> float:
        """Of the observation; see ``biases.stretch``."""
        if self.columns is None or not self.looked.believed:
            return 0.0
        return stretch(self.observation, self.used.size, self.seen, self.looked.innovation, self.looked.innovation_cov)
