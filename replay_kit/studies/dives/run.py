"""Each dive predicted from the dives before it, beside baselines without an estimator."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from replay_kit.config.run import RunConfig
from replay_kit.core.arrays import Array
from replay_kit.core.errors import MeasurementError
from replay_kit.core.gaussian import coverage
from replay_kit.core.progress import Progress, silent
from replay_kit.core.surfacing import DiveOutcome
from replay_kit.core.tasks import each_call
from replay_kit.estimator.evolving import EvolvingEstimator, EvolvingState
from replay_kit.studies.dives.forecasts import (
    DiveForecasts,
    Expected,
    Usable,
    after_dive,
    baseline_means,
    baseline_profiles,
    before_dives,
    expect,
    withheld,
)
from replay_kit.studies.dives.read import Dive
from replay_kit.workflows.replay.scoring import rms_length

SHARES = (0.5, 0.9)


@dataclass(frozen=True, slots=True, eq=False)
class DivePrediction:
    """One dive, predicted from those before it.

    Attributes:
        number: Of the dive.
        errors: Measured minus predicted [m/s], by kind and method; without methods for the first dive. ``profiles``: shape (n, 2), at all
            bins; ``mean``: shape (1, 2), of the depth-averaged current.
        std: shape (n, 2) [m/s], of the estimate's.
        nis: Normalised square of the filter's errors, profile by profile.
        dof: Its degrees of freedom.
        surfacing: Beside what was expected; None where the log has no mean current between fixes.
        withheld: shape (m,) [m/s], errors of the bins withheld from the dive.
        withheld_std: shape (m,) [m/s].
    """

    number: int
    errors: Mapping[str, Mapping[str, Array]]
    std: Array
    nis: float
    dof: int
    surfacing: DiveOutcome | None
    withheld: Array
    withheld_std: Array


@dataclass(frozen=True, slots=True, eq=False)
class DivesResult:
    """All dives of logs, predicted.

    Attributes:
        dives: In order; the first is predicted by the prior forecast.
        ensemble: Its file.
        oscillators: What oscillated.
        unfinished: Whether more dives were to follow when this was written.
    """

    dives: tuple[DivePrediction, ...]
    ensemble: str
    oscillators: tuple[str, ...]
    unfinished: bool = False

    def rmse(self, kind: str) -> dict[str, float]:
        """Return the root mean square length of the error vectors of each method over all dives but the first that have any [m/s].

        Args:
            kind: ``profiles`` or ``mean``.
        """
        of_dives = [dive.errors[kind] for dive in self.dives[1:]]
        methods = {method: None for errors in of_dives for method in errors}
        return {
            method: rms_length(
                np.concatenate([errors[method] for errors in of_dives if method in errors])
            )
            for method in methods
        }

    @property
    def nis_per_dof(self) -> float:
        """Normalised square of the filter's errors over its degrees of freedom, all dives but the first."""
        dof = sum(dive.dof for dive in self.dives[1:])
        return sum(dive.nis for dive in self.dives[1:]) / dof if dof else math.nan

    def coverages(self) -> dict[str, dict[float, float]]:
        """Return which shares of next dives' bins, and of withheld bins, lie in the intervals that should hold a share of them."""
        after = self.dives[1:]
        kinds = {
            "next_dive": [
                (dive.errors["profiles"]["estimate"].ravel(), dive.std.ravel())
                for dive in after
                if dive.errors["profiles"]
            ],
            "withheld": [(dive.withheld, dive.withheld_std) for dive in after],
        }
        out = {}
        for name, parts in kinds.items():
            error, std = (
                np.concatenate([part[k] for part in parts]) if parts else np.empty(0)
                for k in range(2)
            )
            out[name] = {
                share: coverage(error, std, share) if error.size else math.nan for share in SHARES
            }
        return out


def run_dives(
    estimator: EvolvingEstimator,
    dives: Sequence[Dive],
    config: RunConfig,
    source: str,
    progress: Progress = silent,
) -> Iterator[DivesResult]:
    """Yield the dives predicted so far, each from the dives before it, after each dive; the last result has them all.

    Args:
        estimator: As configured.
        dives: In order, at least two.
        config: What the estimator was built with.
        source: The ensemble's file.
        progress: Called with dives done, dives in all, and what is being done.

    Raises:
        MeasurementError: Nothing of the dives lies in the ensemble's region.
    """
    done = list[DivePrediction]()
    for prediction in each_call(_predicted, _each_before(estimator, dives, progress)):
        done.append(prediction)
        unfinished = len(done) < len(dives)
        if not unfinished and not any(dive.dof or dive.errors["mean"] for dive in done):
            raise MeasurementError(
                f"{source}: none of the {len(dives)} dives has a bin or a mean current in the ensemble's region; use an ensemble of the "
                "right place, or --place-ensemble for a study"
            )
        yield DivesResult(tuple(done), source, config.time.oscillators, unfinished)


def _each_before(
    estimator: EvolvingEstimator, dives: Sequence[Dive], progress: Progress
) -> Iterator[tuple[Any, ...]]:
    """Yield the arguments of ``_predicted`` for each dive; one follows from the other."""
    state, known = estimator.initial(), before_dives(dives)
    for k, dive in enumerate(dives):
        progress(k, len(dives), f"dive {dive.number}")
        expected = [(profile, expect(estimator, state, profile)) for profile in dive.profiles]
        usable = [(profile, found) for profile, found in expected if found is not None]
        known, forecasts = after_dive(known, estimator, state, dive, usable)
        yield estimator, state, dives[:k], dive, (usable, forecasts)
        for observation in dive.given:
            state, _ = estimator.step(state, observation)


def _predicted(
    estimator: EvolvingEstimator,
    state: EvolvingState,
    earlier: Sequence[Dive],
    dive: Dive,
    known: tuple[Usable, DiveForecasts],
) -> DivePrediction:
    """Return one dive predicted from the state at its beginning."""
    usable, forecasts = known
    mean = None if dive.mean is None else expect(estimator, state, dive.mean)
    held = list(withheld(estimator, state, [profile for profile, _ in usable]))
    return DivePrediction(
        number=dive.number,
        errors={
            "profiles": _profile_errors(estimator, earlier, usable, forecasts.error)
            if earlier and usable
            else {},
            "mean": _mean_errors(estimator, earlier, dive, (mean, forecasts))
            if earlier and mean is not None
            else {},
        },
        std=forecasts.std,
        nis=sum(found.nis for _, found in usable),
        dof=sum(found.dof for _, found in usable),
        surfacing=forecasts.outcome,
        withheld=np.concatenate([np.empty(0), *(error for error, _ in held)]),
        withheld_std=np.concatenate([np.empty(0), *(std for _, std in held)]),
    )


def _profile_errors(
    estimator: EvolvingEstimator,
    earlier: Sequence[Dive],
    usable: Usable,
    expected: Array,
) -> dict[str, Array]:
    """Return the errors of the estimate, of the filter alone, of the ensemble, and of the baselines."""
    errors: dict[str, list[Array]] = {
        "estimate": [expected],
        "filter_alone": [],
        "ensemble_mean": [],
    }
    for profile, found in usable:
        errors["filter_alone"].append(found.error)
        errors["ensemble_mean"].append(
            estimator.innovation(estimator.initial(), profile)[found.used]
        )
        depth, velocity = profile.depth[found.used], profile.velocity[found.used]
        for name, predicted in baseline_profiles(earlier, depth).items():
            errors.setdefault(name, []).append(velocity - predicted)
    return {name: np.concatenate(parts) for name, parts in errors.items()}


def _mean_errors(
    estimator: EvolvingEstimator,
    earlier: Sequence[Dive],
    dive: Dive,
    found: tuple[Expected, DiveForecasts],
) -> dict[str, Array]:
    """Return the errors of the dive's mean current, method by method; without fixes the estimate is the filter alone."""
    assert dive.mean is not None
    alone, expected = found[0].error, found[1].mean_error
    errors = {"estimate": alone if expected is None else expected, "filter_alone": alone}
    errors |= {"ensemble_mean": estimator.innovation(estimator.initial(), dive.mean)}
    return errors | {
        name: np.array([dive.mean.velocity]) - predicted
        for name, predicted in baseline_means(earlier).items()
    }
