"""Small results of studies, written down, to make pages of."""

from typing import Any

import numpy as np

from replay_kit.core.observation import Fix
from replay_kit.core.surfacing import DiveForecast, DiveOutcome, Ellipse
from replay_kit.studies.accuracy import AccuracyResult
from replay_kit.studies.accuracy.run import AccuracyRow
from replay_kit.studies.dives import DivesResult
from replay_kit.studies.dives.run import DivePrediction
from replay_kit.studies.missions import MissionJob
from replay_kit.studies.missions.follow import MissionRow
from replay_kit.studies.missions.run import MissionResult
from replay_kit.studies.planning import PlanningJob
from replay_kit.studies.planning.odds import JudgedMission, PlanningResult
from replay_kit.studies.reports.tables import NAN


def accuracy_result() -> AccuracyResult:
    """Three methods, of which one fails and one states no errors."""
    rows = [
        AccuracyRow(
            method,
            pings,
            error,
            (error - 0.01, error + 0.01),
            0.3 * error,
            0.05,
            nis,
            0.5,
            0.8,
            0.02,
        )
        for method, errors, nis in (
            ("default", (0.4, 0.2), 1.1),
            ("ensemble_mean", (0.5, 0.5), NAN),
        )
        for pings, error in zip((5, 50), errors, strict=True)
    ]
    failed = AccuracyRow("etkf", 50, failed="seed 0: LinAlgError: <singular>")
    return AccuracyResult((*rows, failed), "ensemble.nc", "truth.nc", 20, 0.09)


def dives_result() -> DivesResult:
    """Three dives, the first without errors; the last without a mean current."""

    def dive(number: int, error: float) -> DivePrediction:
        profiles = (
            {"estimate": np.full((4, 2), error), "last_dive": np.full((4, 2), 2.0 * error)}
            if number > 1
            else {}
        )
        mean = (
            {"estimate": np.full((1, 2), error), "last_dac": np.full((1, 2), 3.0 * error)}
            if number == 2
            else {}
        )
        inner, outer = (Ellipse(152.0, -40.0, axis, axis - 200.0, 90.0) for axis in (600.0, 900.0))
        start, fix = Fix(0, 151.9, -40.0), Fix(3_600 * 10**9, 152.01, -40.0)
        expected = DiveForecast(
            number, number - 1, start, fix.time_ns, 152.0, -40.0, inner, outer, NAN
        )
        found = DiveOutcome(expected, fix, 2.0, NAN, NAN) if number < 3 else None
        errors: dict[str, Any] = {"profiles": profiles, "mean": mean}
        return DivePrediction(
            number,
            errors,
            np.full((4, 2), 0.1),
            8.0,
            8,
            found,
            np.full(3, 0.05),
            np.full(3, 0.1),
        )

    return DivesResult(
        (dive(1, 0.1), dive(2, 0.1), dive(3, 0.2)),
        "ensemble.nc",
        oscillators=("steady",),
    )


def mission_result() -> MissionResult:
    """Two studies; one figure does not keep to its limit, one has a unit."""
    rows = (
        MissionRow("outliers", "gate soften", "RMSE [m/s]", 0.2, NAN, NAN, None, (0.19, 0.21)),
        MissionRow(
            "outliers",
            "gate soften",
            "RMSE over that without outliers",
            1.2,
            NAN,
            1.05,
            False,
            (1.1, 1.3),
        ),
        MissionRow(
            "bias",
            "biased, with bias states",
            "heading over its standard deviation",
            3.2,
            3.0,
            9.0,
            True,
            (3.1, 3.3),
        ),
    )
    job = MissionJob("2,5", ("outliers", "bias"), 20, 1.0, 0.09, 1)
    return MissionResult(
        rows, "ensemble.nc", (2, 5), 1, job, ("member 5, seed 0, bias: carried away",)
    )


def planning_result() -> PlanningResult:
    """Two missions reported as reached, of which one arrives, and one that is not."""
    missions = (
        JudgedMission(1, "reached", 0.95, 0.9, 120.0, 250.0),
        JudgedMission(1, "reached", 0.975, 0.94, 400.0, 250.0),
        JudgedMission(3, "unreachable", 0.2, NAN, NAN, 250.0),
    )
    job = PlanningJob("1,3", pairs=3)
    return PlanningResult(
        missions, "ensemble.nc", ("member 1", "member 3"), 6, (5.0, 150.0), 8, job
    )
