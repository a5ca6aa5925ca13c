"""A result of version 0.1 can still be opened: by the library, and by every command that takes a result.

``data/version_0_1.mcap`` was made by the code of 22 November 2026, contract version 2:
``twin --vehicle glider --pings 20 --seed 3`` of the sample
truth, ``replay --levels 5,500 --modes 2 --goal=152.8,-40.1,300`` of it with the sample ensemble.
"""

import json
from pathlib import Path

import pytest

import replay_kit as rk
from tests.command import invoke

OLD = str(Path(__file__).parent / "data" / "version_0_1.mcap")


def test_the_library_opens_it():
    result = rk.open_result(OLD)
    assert len(result.fixes) == 25
    at = result.estimate.to_xarray().sel(
        longitude=152.9, latitude=-40.2, depth=5.0, method="nearest"
    )
    # as that code read it
    found = [float(at[name].item()) for name in ("u", "v", "u_standard_error")]
    assert found == pytest.approx(
        [-0.10767233474613547, 0.0012569213129041976, 0.033569508312566144], rel=1e-12
    )


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["status", OLD, "-v"], 0, "an earlier version made the result"),
        (["report", OLD, "-o", "{}/r.html"], 0, "open it in a browser"),
        (["plot", OLD, "map", "-o", "{}/r.png"], 0, "Figure:"),
        (["export", OLD, "-o", "{}/r.csv"], 0, "track 25 rows"),
        (["export", OLD, "-o", "{}/r.nc"], 0, "The result has version 2 of the contract"),
        (["layout", OLD, "-o", "{}/layout.json"], 0, "layout.json"),
        (
            ["plan", OLD, "--start=152.4,-40.2,0", "--goal=152.45,-40.18,0", "--depth", "300"],
            0,
            "samples of the estimate arrive",
        ),
        (
            ["info", OLD],
            0,
            "Use: a result of a replay, to be opened with status, report, plot, export or plan.",
        ),
    ],
    ids=lambda value: value[0] if isinstance(value, list) else None,
)
def test_each_command_opens_it(tmp_path, words, code, said):
    done = invoke([word.format(tmp_path) for word in words])
    assert (done.exit_code, done.exception) == (code, None)
    assert said in " ".join(done.output.split())


def test_the_replay_that_made_it_can_be_named_and_is_not_the_same_any_more(tmp_path):
    done = invoke(["verify", OLD, "--json", str(tmp_path / "v.json")])
    assert done.exit_code in (3, 5)
    if done.exit_code == 5:
        assert json.loads((tmp_path / "v.json").read_text())["difference"]
