"""Every benchmark once at a tiny size: it runs, and what it measures is right. Never how long it took."""

import json

import pytest

from tests.benchmarks.__main__ import BENCHMARKS, main

# Of the mean and of the covariance, relative; share of the time by which a path is slower.
ALLOWED = {
    "late": 1e-3,
    "turned": 0.5,
    "unsafe": 0.12,
    "crossed": 1,
    "below": 1,
    "messages": 0.5,
    "mean": 1e-8,
    "covariance": 1e-6,
    "differing": 1,
    "rmse": 0.01,
    "unused": 1,
}
# The others take four seconds and more even at a tiny size, some for the processes that they begin.
QUICK = ("dives", "estimator", "forecasts", "logs", "pings", "size", "windows")


@pytest.mark.parametrize(
    "name",
    [name if name in QUICK else pytest.param(name, marks=pytest.mark.full) for name in BENCHMARKS],
)
def test_every_benchmark_runs_and_its_answers_are_right(name, tmp_path, capsys):
    file = tmp_path / "benchmarks.json"
    main([name, "--tiny", "--json", str(file)])
    result = json.loads(file.read_text())
    said = capsys.readouterr().out
    assert "asked" in said or all(row["ratio"] is None for row in result["rows"])
    assert {"rows", "machine", "versions", "limits"} <= set(result)
    assert result["rows"]
    for row in result["rows"]:
        assert {"name", "ours_s", "peer", "peer_s", "ratio", "asked", "error", "peak_mb"} <= set(
            row
        )
        for name, value in row["error"].items():
            allowed = ALLOWED.get(name.split("_")[0])
            assert allowed is None or value < allowed, (row["name"], name, value)
