"""Logs that are readable and wrong: what a replay names, what it leaves out, and how it ends."""

import json
from functools import cache

import numpy as np
import pytest

from replay_kit.config.run import RunConfig
from replay_kit.core.errors import Finding, ForecastError, MeasurementError, finding_text
from replay_kit.logs import open_log
from replay_kit.logs.mcap.writer import write_mcap_log
from replay_kit.measurements.checks import causes as findings
from replay_kit.measurements.checks.causes import COMPASS, SCALE
from replay_kit.measurements.checks.check import Checked
from replay_kit.measurements.checks.place import FROZEN, REPEATED
from replay_kit.measurements.checks.profile import ENSEMBLE
from replay_kit.measurements.means import TOO_FAST
from replay_kit.measurements.track.reach import THROWN
from replay_kit.results.views.contents import Contents
from replay_kit.show.notebook import Result, read_result
from replay_kit.show.report.answer import found_warnings
from replay_kit.studies.twins.make import Twin
from replay_kit.workflows.replay.consistency import MonitoringState, conclusions
from replay_kit.workflows.replay.replay import replay
from replay_kit.workflows.replay.steps import Counts, Sums
from tests.benchmarks.fault_kinds import FAULTS
from tests.command import invoke
from tests.faulty import Faults, write_glider
from tests.planted import in_centimetres
from tests.workflows.replay.given import moved
from tests.workflows.replay.interrupted import QUICK, goes_on, job_in, make_ocean, often, truth_in

CONFIG = RunConfig(estimator=QUICK | {"modes": 20}, output={"interval": 7200.0})
EDITS = {fault.name: fault.edit for fault in FAULTS}
PINGS = 60
SIGNS = "profiles: both signs"


@pytest.fixture(scope="module")
def ocean(tmp_path_factory):
    folder = make_ocean(tmp_path_factory.mktemp("ocean"), CONFIG, PINGS)
    glider, turned = Twin("glider", PINGS, 0.05, 1), Faults(heading_bias_deg=180.0)
    write_glider(truth_in(folder, CONFIG), glider, folder / "turned.mcap", turned)
    return folder


def faulty(ocean, name):
    """The glider's log with a fault."""
    path = ocean / f"{''.join(filter(str.isalnum, name))}-faulty.mcap"
    if not path.exists():
        write_mcap_log(path, list(EDITS[name](open_log(ocean / "glider.mcap").messages())))
    return path


def with_settings(**tables):
    """The configuration with other tables of settings."""
    return CONFIG.model_copy(update={name: getattr(RunConfig(**tables), name) for name in tables})


def run(ocean, log, config=CONFIG):
    return replay(job_in(ocean, ocean / "out.mcap", logs=(log,)), config)[0]


@pytest.fixture(scope="module")
def summary_of(ocean):
    """Return the summary of the glider's log with a fault, or of the sound one, made once for all tests."""

    @cache
    def summary(name=None):
        return run(ocean, faulty(ocean, name) if name else "glider.mcap")

    return summary


def test_a_sound_log_has_no_finding_and_a_verdict(summary_of):
    answer = summary_of().to_json()
    assert (answer["status"], answer["consistency"]) == ("done", [])
    assert (answer["exit_code"], answer["exit_codes"]) == (0, [])
    # six pings lie outside the water of the ensemble
    assert answer["basis"][:2] == ["60 of 66 observations used", "no contradiction found"]
    misfit = f"misfit {100.0 * summary_of().rms_innovation['before']:.1f} cm/s "
    assert answer["basis"][2].startswith(misfit)


def test_a_turned_instrument_is_left_out_and_the_estimate_is_rebuilt_without_it(ocean):
    summary = run(ocean, "turned.mcap")
    (finding,) = summary.consistency
    assert finding["name"] == "compass or instrument turned"
    assert "turned by +180 degrees clockwise" in finding["evidence"]
    assert summary.exit_code == 6
    assert (summary.observations["used"], summary.observations["rejected"]) == (6, PINGS)
    turned = Result(ocean / "out.mcap")
    estimate, events = turned.estimate, turned.events
    # the estimate is that of the mean currents alone
    run(ocean, moved(ocean / "turned.mcap", ocean / "means.mcap", without=("/adcp",)))
    places = np.array([0.0, 2e4]), np.array([0.0, -1e4]), np.array([20.0, 60.0])
    alone = Result(ocean / "out.mcap").estimate.velocity(*places)
    assert alone == pytest.approx(estimate.velocity(*places), abs=1e-9)
    assert (events["level"] == "warning").sum() == 1
    assert events["message"].iloc[0] == finding_text(finding)


def test_a_wrong_unit_ends_the_run_unless_it_is_stated(ocean, summary_of):
    log = faulty(ocean, "cm/s")
    with pytest.raises(MeasurementError, match=r'measurements\.velocity_unit = "cm/s"') as error:
        run(ocean, log)
    assert error.value.exit_code == 3
    mended, odd = (
        run(ocean, log, with_settings(measurements={"velocity_unit": unit}))
        for unit in ("cm/s", "m/s")
    )
    assert mended.consistency == ()
    after = summary_of().rms_innovation["after"]
    assert mended.rms_innovation["after"] == pytest.approx(after, rel=1e-9)
    assert (odd.consistency[0]["name"], odd.exit_code) == ("unit of the velocities", 6)


@pytest.mark.parametrize(
    ("fault", "names", "rejected", "reason"),
    [
        # eleven pings come before it hangs, one of them at the surface
        ("stale from ping 11", ["dead or stale instrument"], PINGS - 11 + 1, "dead"),
        ("sign of depth", ["depths above the surface"], PINGS, "above_surface"),
        # until a fix repeats the one before the dive it may be a vehicle that does not reckon its way
        ("frozen positions", [REPEATED, FROZEN], None, "inconsistent"),
    ],
)
def test_profiles_of_a_fault_are_not_used_and_counted(summary_of, fault, names, rejected, reason):
    summary = summary_of(fault)
    assert [finding["name"] for finding in summary.consistency] == names
    assert rejected in (None, summary.observations["rejected"])
    assert summary.observations["bins_rejected"][reason] > 0
    assert summary.exit_code == 6


def test_an_ensemble_in_another_unit_is_refused_unless_checks_are_ignored(ocean, tmp_path):
    in_centimetres(ocean / "ensemble.nc", tmp_path / "cm.nc")
    job = job_in(ocean, ensemble=tmp_path / "cm.nc")
    with pytest.raises(ForecastError, match=r"unit of the ensemble: .*cm\.nc: RMS speed") as error:
        replay(job, CONFIG)
    assert [finding.severity for finding in error.value.findings] == ["unusable"]
    ignored = replay(job, with_settings(consistency={"on_failure": "ignore"}))[0]
    assert (ignored.consistency, ignored.exit_code) == ((), 0)
    assert ignored.doubts[0] == "no consistency check was made (consistency.on_failure)"


KEYS = "format_version status exit_code observations rms_innovation by_dive nis_per_dof plan truth"


@pytest.mark.parametrize(
    ("fault", "more", "codes", "status"),
    [
        (SIGNS, "", [6], "inconsistent"),
        (SIGNS, '[consistency]\non_failure = "stop"\n', [3, 6], "failed"),
        ("all zero", "[measurements]\nwithout = ['dac']\n", [3, 6], "failed"),
        ("up for down", "[measurements]\nwithout = ['dac']\n", [6], "inconsistent"),
    ],
)
def test_how_a_run_with_a_contradiction_ends_is_in_its_answer(
    ocean, tmp_path, fault, more, codes, status
):
    settings, answer, out = (tmp_path / name for name in ("run.toml", "answer.json", "out.mcap"))
    quick = (
        "time.scale = 'static'\n[estimator]\nmodes = 20\nsample_share = 0.5\nshift_distance = 0.0\n"
    )
    settings.write_text(quick + more)
    files = f"--ensemble {ocean}/ensemble.nc --config {settings} -o {out}"
    done = invoke(f"replay {faulty(ocean, fault)} {files} --json {answer}")
    said = json.loads(answer.read_text())
    assert {*KEYS.split(), "seconds"} <= set(said)
    assert (done.exit_code, said["exit_code"]) == (codes[0], codes[0])
    assert (said["exit_codes"], said["status"], out.exists()) == (codes, status, codes == [6])
    assert set(said["messages"][0]) == {"topic", "read", "used", "skipped", "reasons"}
    (finding,) = said["consistency"]
    assert set(finding) == {"name", "since", "evidence", "likely_cause", "set", "severity"}
    if fault == SIGNS:
        assert finding["name"] == "two sources of the current contradict each other"
        assert "both signs wrong" in finding["evidence"]
    if codes == [3, 6]:
        assert said["error"] in done.stderr
        assert ("dead" if fault == "all zero" else finding["name"]) in said["error"]
    elif fault == SIGNS:
        # the gate rejects neither, also what came before it was known; the six rejected lie outside the water of the ensemble
        assert (said["observations"]["used"], said["observations"]["rejected"]) == (PINGS, 6)
        assert done.stdout.startswith(f"DO NOT USE {finding['name']}: ")
        assert f"\nCONTRADICTION: {finding['name']} (since " in done.stdout
    else:
        assert said["observations"]["used"] == 0
        assert "no observation changed the estimate: it is the prior forecast" in said["basis"]


def in_other_water(messages):
    """Yield messages with pings in water that no forecast has: at each the whole profile is pushed by some 0.45 m/s of its own.

    Mean currents, which would contradict these, are left out.
    """
    rng = np.random.default_rng(0)
    for message in messages:
        if message.schema == "replay_kit.AdcpPing":
            push = [*rng.normal(0.0, 0.45, 2), 0.0]
            moved = np.array(message.payload["velocity"], float) + push
            velocity = np.where(np.isnan(moved), None, moved).tolist()
            message = message._replace(payload={**message.payload, "velocity": velocity})
        if message.topic != "/dac":
            yield message


@pytest.mark.parametrize(
    ("place", "name", "severity", "code"),
    [(False, findings.MISFIT, "misfit", 6), (True, findings.MISFIT_OF_MOVED, "warning", 0)],
)
def test_a_forecast_that_does_not_fit_is_told_apart_from_a_fault_of_the_log(
    ocean, tmp_path, place, name, severity, code
):
    log = tmp_path / "other.mcap"
    write_mcap_log(log, list(in_other_water(open_log(ocean / "glider.mcap").messages())))
    summary = run(ocean, log, with_settings(forecast={"place": place}))
    (finding,) = summary.consistency
    assert (finding["name"], finding["severity"], summary.exit_code) == (name, severity, code)
    beyond, total = (int(word) for word in finding["evidence"].split() if word.isdigit())
    assert (total, beyond > 40) == (54, True)
    assert summary.basis[1].startswith(f"the log does not contradict itself, but {name}: ")
    shown = found_warnings(Contents(read_result(ocean / "out.mcap")))
    assert sum(finding["evidence"] in text for kind, text in shown if kind != "note") == 1


def gated(profiles, beyond):
    return Counts(total=Sums(profiles=profiles, gated=beyond))


def refused(**decisions):
    return Counts(kinds={kind: Sums(n - of, refused=of) for kind, (n, of) in decisions.items()})


def skipped(reason, used):
    return Counts({("/x", ""): used, ("/x", reason): 12, ("/y", "other"): 3})


@pytest.mark.parametrize(
    ("counts", "name", "words"),
    [
        # two thirds beyond the gate, of three at least
        (gated(5, 10), findings.MISFIT, ""),
        (gated(6, 9), ENSEMBLE, ""),
        (gated(8, 4), None, ""),
        (gated(3, 3), ENSEMBLE, ""),
        (gated(0, 2), ENSEMBLE, ""),
        # most of one source, and both are named
        (refused(profiles=(100, 2), dac=(15, 14)), findings.PREFERRED, "the profiles"),
        (refused(profiles=(100, 90), dac=(15, 0)), findings.PREFERRED, "mean currents"),
        (refused(profiles=(100, 2), dac=(15, 4)), None, ""),
        (refused(profiles=(100, 60), dac=(15, 12)), None, ""),
        (refused(dac=(15, 14)), None, ""),
        # too many of a topic
        (skipped(TOO_FAST, 0), SCALE, "12 of 12 mean currents"),
        (skipped(THROWN, 36), None, ""),
        (skipped(THROWN, 35), findings.MIXED, "12 of 47 positions"),
    ],
)
def test_what_counts_of_a_run_lead_to(counts, name, words):
    found, _ = conclusions(MonitoringState(), counts, RunConfig())
    assert [one.name for one in found] == [name] * (name is not None)
    assert all(words in f"{one.evidence} {one.cause}" for one in found)


def test_what_the_log_says_against_itself_explains_the_rest():
    compass, frozen = (Finding(name, 0, "", "", "") for name in (COMPASS, FROZEN))
    known = MonitoringState(findings=(compass,))
    assert conclusions(known, gated(5, 10), RunConfig())[0] == (compass,)
    for pings in (0, 1):
        state = MonitoringState(Checked(pings=(pings, pings)), (frozen,))
        assert state.explains_no_profile == (pings > 0)
    (said,) = conclusions(MonitoringState(state.checks), Counts(), RunConfig())[1]
    assert said.startswith("nothing here can tell whether directions are right")


@pytest.mark.full
def test_a_run_stopped_around_a_finding_gives_the_same_bytes(ocean, tmp_path):
    job = job_in(ocean, tmp_path / "out.mcap", logs=(faulty(ocean, SIGNS),))
    assert goes_on(job, often(CONFIG), 60, 40).exit_code == 6
