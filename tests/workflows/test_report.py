"""The command ``report``, and ``replay --report``."""

# fixtures of other modules are imported by their names
# ruff: noqa: F811

import json

from replay_kit.workflows.report import page_of, report
from tests.command import invoke, succeed
from tests.places import SAMPLES
from tests.show.report.conftest import page, replayed, result_path  # noqa: F401 - fixtures
from tests.show.report.html_of import elements, text_of

SHORT = "--end 2018-11-16T02:00:00Z --levels 5,150 --modes 5"


def test_the_command_names_the_page(result_path, page, tmp_path):
    outcome = succeed(f"report {result_path} -o {tmp_path}/page.html")
    assert (tmp_path / "page.html").read_text() == page
    assert f"Report: {tmp_path / 'page.html'} (" in outcome.stdout
    again = invoke(f"report {result_path} -o {tmp_path}/page.html")
    assert again.exit_code == 2
    assert "exists; choose another name or give --overwrite" in again.stderr
    assert invoke(f"report {result_path} -o {tmp_path}/page.pdf").exit_code == 2


def test_a_replay_makes_the_page_with_the_score_against_a_truth(tmp_path):
    logs, out = f"{SAMPLES}/survey.mcap --ensemble {SAMPLES}/ensemble.nc", tmp_path / "out.mcap"
    more = f"--truth {SAMPLES}/truth.nc --json {tmp_path}/out.json --report"
    outcome = succeed(f"replay {logs} -o {out} {SHORT} {more}")
    assert f"{out}, {tmp_path}/out.html" in outcome.stdout.replace("\n", "")
    made = (tmp_path / "out.html").read_text()
    carried = {attrs["data-key"]: attrs["value"] for attrs, _ in elements(made, "data")}
    summary = json.loads((tmp_path / "out.json").read_text())
    assert json.loads(carried["truth.rmse"]) == summary["truth"]["rmse"]
    assert "10 measurements of the current used; misfit" in text_of(made, "answer")
    files = f"-o {tmp_path}/other.mcap --report --netcdf {tmp_path}/other.html"
    refused = invoke(f"replay {logs} {SHORT} {files}")
    assert refused.exit_code == 2
    report(out, tmp_path / "later.html")
    assert 'data-key="truth.rmse"' not in (tmp_path / "later.html").read_text()


def test_a_result_that_is_cut_short_shows_what_is_left(result_path, tmp_path):
    cut, data = tmp_path / "cut.mcap.part", result_path.read_bytes()
    cut.write_bytes(data[: int(0.6 * len(data))])
    assert page_of(cut) == tmp_path / "cut.html"
    report(cut, page_of(cut))
    made = (tmp_path / "cut.html").read_text()
    words = text_of(made, "answer")
    for said in (
        "LOST: cut.mcap.part: ",
        "only its recoverable content",
        "carries no estimate.npz",
    ):
        assert said in words
    assert len(elements(made, "figure")) >= 4
    assert "replay_kit_" not in made.split("<script")[0]


def test_a_result_of_another_version_says_so(result_path, tmp_path, monkeypatch):
    monkeypatch.setattr("replay_kit.workflows.report.CONTRACT_VERSION", 7)
    report(result_path, tmp_path / "page.html")
    said = text_of((tmp_path / "page.html").read_text(), "answer")
    assert "The result has version 6 of the contract, this program version 7" in said


def test_names_of_files_topics_and_frames_are_text_in_the_page(tmp_path):
    evil = "<img src=x onerror=alert(1)>"
    topic = "</script><script>alert(1)</script>"
    logs = [tmp_path / f"{evil}{name}" for name in (".mcap", ".nc")]
    for sample, log in zip(("survey.mcap", "ensemble.nc"), logs, strict=True):
        log.write_bytes((SAMPLES / sample).read_bytes())
    files = ["--ensemble", str(logs[1]), "-o", str(tmp_path / f"{evil}out.mcap")]
    remaps = [f"--remap=/adcp={topic}", f"--remap=/vehicle/fix={topic}fix", "--report"]
    outcome = invoke(["replay", str(logs[0]), *files, *SHORT.split(), *remaps])
    assert outcome.exit_code in (0, 6), outcome.stderr
    made = (tmp_path / f"{evil}out.html").read_text()
    assert "&lt;img src=x onerror" in made
    assert "alert(1)" in made
    assert "<img" not in made
    assert "<script>alert" not in made
