"""Small results of studies, written down, to make pages of."""

from replay_kit.studies.bench.frame import BenchResult, Figure, Lost, of_case, rows_of
from replay_kit.studies.reports.tables import NAN


def bench_result() -> BenchResult:
    """Methods against pings, of which one fails and one states no errors; dives of two missions; figures with limits."""
    figures = [
        Figure(method, name, value, after=pings, task="pings", case=f"seed {seed}")
        for method, errors, nis in (
            ("default", (0.4, 0.2), 1.1),
            ("ensemble_mean", (0.5, 0.5), NAN),
        )
        for pings, error in zip((5, 50), errors, strict=True)
        for seed, add in enumerate((-0.01, 0.01))
        for name, value in (("relative error", error + add), ("NIS per degree of freedom", nis))
    ]
    for case, ratio, hits in (("sg1", -0.2, 2.0), ("sg2", -0.4, 7.0)):
        figures += of_case(
            [
                Figure("process", "over last dive", ratio, pool="geometric"),
                Figure("process", "RMS error [cm/s]", 9.0 * hits, hits, pool="rms"),
                Figure("process", "coverage 90 %", hits, 8.0),
            ],
            "next-dive",
            case,
        )
    figures += of_case(
        [
            Figure("gate soften", "RMSE over clean", 1.2, at_most=1.05),
            Figure("gate soften", "outliers rejected or softened", 9.0, 9.0, at_least=0.5),
        ],
        "outliers",
        "member 2, seed 0",
    )
    lost = [
        Lost("pings", "seed 0", "LinAlgError: <singular>", "etkf", 50),
        Lost("outliers", "member 5, seed 0", "carried away"),
    ]
    inputs = {"ensemble": "ensemble.nc", "missions": {}, "job": {"surveys": {"noise": 0.09}}}
    return BenchResult(rows_of(figures, lost), tuple(map(str, lost)), inputs)
