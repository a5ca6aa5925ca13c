"""Logs that are readable and wrong: what a replay names, what it leaves out, and how it ends."""

import json
import re
from functools import cache

import numpy as np
import pytest

from replay_kit.config.run import RunConfig
from replay_kit.core.errors import (
    Finding,
    ForecastError,
    MeasurementError,
    finding_line,
    finding_text,
)
from replay_kit.logs import open_log
from replay_kit.logs.mcap.writer import write_mcap_log
from replay_kit.measurements.checks import concluded as findings
from replay_kit.measurements.checks.causes import COMPASS, SCALE
from replay_kit.measurements.checks.check import Checked
from replay_kit.measurements.checks.place import FROZEN, REPEATED
from replay_kit.measurements.checks.profile import ENSEMBLE
from replay_kit.measurements.means import TOO_FAST
from replay_kit.measurements.track.reach import THROWN
from replay_kit.results.views.contents import Contents
from replay_kit.show.notebook import Result, read_result
from replay_kit.show.report.sections.answer import found_warnings
from replay_kit.studies.twins.make import Twin
from replay_kit.workflows.replay.inputs.job import ReplayJob
from replay_kit.workflows.replay.replay import replay
from replay_kit.workflows.replay.stages.consistency import MonitoringState, conclusions
from replay_kit.workflows.replay.stages.counts import Counts, Sums
from tests.benchmarks.fault_kinds import FAULTS
from tests.command import invoke
from tests.faulty import Faults, write_glider
from tests.planted import in_centimetres
from tests.workflows.replay.given import moved
from tests.workflows.replay.interrupted import goes_on, make_ocean, often, truth_in

CONFIG = RunConfig(
    estimator={"modes": 20, "sample_share": 0.5, "shift_distance": 0.0},
    output={"interval": 7200.0},
)
EDITS = {fault.name: fault.edit for fault in FAULTS}
PINGS = 60


@pytest.fixture(scope="module")
def ocean(tmp_path_factory):
    folder = make_ocean(tmp_path_factory.mktemp("ocean"), CONFIG, PINGS)
    glider, turned = Twin("glider", PINGS, 0.05, 1), Faults(heading_bias_deg=180.0)
    write_glider(truth_in(folder, CONFIG), glider, folder / "turned.mcap", turned)
    return folder


def faulty(ocean, name):
    """The glider's log with a fault."""
    messages = list(EDITS[name](open_log(ocean / "glider.mcap").messages()))
    path = ocean / f"{''.join(filter(str.isalnum, name))}-faulty.mcap"
    if not path.exists():
        write_mcap_log(path, messages)
    return path


def with_settings(**tables):
    """The configuration with other tables of settings."""
    return CONFIG.model_copy(update={name: getattr(RunConfig(**tables), name) for name in tables})


def run(ocean, log, config=CONFIG, **job):
    summary, _ = replay(
        ReplayJob((log,), ocean / "ensemble.nc", ocean / "out.mcap", overwrite=True, **job), config
    )
    return summary


@pytest.fixture(scope="module")
def summary_of(ocean):
    """Return the summary of the glider's log with a fault, or of the sound one, made once for all tests."""

    @cache
    def summary(name=None):
        return run(ocean, ocean / "glider.mcap" if name is None else faulty(ocean, name))

    return summary


def test_a_sound_log_has_no_finding_and_a_verdict(summary_of):
    summary = summary_of()
    assert summary.consistency == ()
    assert (summary.exit_code, summary.exit_codes) == (0, ())
    answer = summary.to_json()
    assert (answer["status"], answer["consistency"], answer["exit_codes"]) == ("done", [], [])
    # six pings lie outside the water of the ensemble
    assert answer["basis"][:2] == ["60 of 66 observations used", "no contradiction found"]
    assert answer["basis"][2].startswith(
        f"misfit {100.0 * summary.rms_innovation['before']:.1f} cm/s before each update, "
    )


def test_a_turned_instrument_is_left_out_and_the_estimate_is_rebuilt_without_it(ocean):
    summary = run(ocean, ocean / "turned.mcap")
    (finding,) = summary.consistency
    assert finding["name"] == "compass or instrument turned"
    assert "turned by +180 degrees clockwise" in finding["evidence"]
    assert summary.exit_code == 6
    observations = summary.to_json()["observations"]
    assert (observations["used"], observations["rejected"]) == (6, PINGS)
    turned = Result(ocean / "out.mcap")
    estimate, events = turned.estimate, turned.events
    # the estimate is that of the mean currents alone
    moved(ocean / "turned.mcap", ocean / "means.mcap", without=("/adcp",))
    run(ocean, ocean / "means.mcap")
    places = np.array([0.0, 2e4]), np.array([0.0, -1e4]), np.array([20.0, 60.0])
    assert Result(ocean / "out.mcap").estimate.velocity(*places) == pytest.approx(
        estimate.velocity(*places), abs=1e-9
    )
    assert (events["level"] == "warning").sum() == 1
    assert events["message"].iloc[0] == finding_text(finding)


def test_a_wrong_unit_ends_the_run_unless_it_is_stated(ocean, summary_of):
    log = faulty(ocean, "cm/s")
    with pytest.raises(
        MeasurementError, match=r'state measurements\.velocity_unit = "cm/s"'
    ) as error:
        run(ocean, log)
    assert error.value.exit_code == 3
    mended, odd = (
        run(ocean, log, with_settings(measurements={"velocity_unit": unit}))
        for unit in ("cm/s", "m/s")
    )
    assert mended.consistency == ()
    assert mended.rms_innovation["after"] == pytest.approx(
        summary_of().rms_innovation["after"], rel=1e-9
    )
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


def test_without_its_profiles_and_mean_currents_a_log_leaves_the_prior(ocean):
    no_means = with_settings(measurements={"without": ("dac",)})
    alone = run(ocean, faulty(ocean, "up for down"), no_means)
    assert (alone.observations["used"], alone.exit_code) == (0, 6)
    assert "no observation changed the estimate: it is the prior forecast" in alone.basis


def test_frozen_positions_of_a_log_without_measurements_are_no_result(ocean):
    positions = [
        message
        for message in open_log(faulty(ocean, "frozen positions")).messages()
        if "latitude" in message.payload
    ]
    write_mcap_log(ocean / "positions.mcap", positions)
    with pytest.raises(MeasurementError, match="no usable ADCP ping"):
        run(ocean, ocean / "positions.mcap")


def test_an_ensemble_in_another_unit_is_refused_unless_checks_are_ignored(ocean, tmp_path):
    in_centimetres(ocean / "ensemble.nc", tmp_path / "cm.nc")
    job = ReplayJob((ocean / "glider.mcap",), tmp_path / "cm.nc")
    with pytest.raises(ForecastError, match=r"unit of the ensemble: .*cm\.nc: RMS speed") as error:
        replay(job, CONFIG)
    assert [(finding.name, finding.severity) for finding in error.value.findings] == [
        ("unit of the ensemble", "unusable")
    ]
    ignoring = with_settings(consistency={"on_failure": "ignore"})
    ignored = replay(job, ignoring)[0]
    assert (ignored.consistency, ignored.exit_code) == ((), 0)
    assert ignored.doubts[0] == "no consistency check was made (consistency.on_failure)"


def invoked(ocean, log, tmp_path, more=""):
    """Exit code, JSON and standard error of a replay on the command line."""
    settings, answer = tmp_path / "run.toml", tmp_path / "answer.json"
    settings.write_text(
        "[estimator]\nmodes = 20\nsample_share = 0.5\nshift_distance = 0.0\n" + more
    )
    files = f"--ensemble {ocean}/ensemble.nc --config {settings} -o {tmp_path}/out.mcap"
    done = invoke(f"replay {log} {files} --json {answer} --overwrite")
    return done, json.loads(answer.read_text())


def test_a_contradiction_ends_with_six_and_is_in_the_answer(ocean, tmp_path):
    done, answer = invoked(ocean, faulty(ocean, "profiles: both signs"), tmp_path)
    assert (done.exit_code, answer["exit_code"], answer["exit_codes"], answer["status"]) == (
        6,
        6,
        [6],
        "inconsistent",
    )
    # the gate rejects neither, also what came before it was known; the six rejected lie outside the water of the ensemble
    used = answer["observations"]
    assert (used["used"], used["rejected"]) == (PINGS, 6)
    assert not [note for note in answer["notes"] if "were rejected" in note]
    (finding,) = answer["consistency"]
    assert "both signs wrong" in finding["evidence"]
    assert set(finding) == {"name", "since", "evidence", "likely_cause", "set", "severity"}
    assert finding["name"] == "two sources of the current contradict each other"
    assert finding["since"].endswith("Z")
    assert answer["basis"][1] == "1 contradiction: two sources of the current contradict each other"
    lines = done.stdout.splitlines()
    assert lines[0].startswith("DO NOT USE two sources of the current contradict each other: ")
    assert any(
        line.startswith("CONTRADICTION: two sources of the current contradict each other (since ")
        for line in lines
    )
    assert [row["topic"] for row in answer["messages"]] == [
        "/adcp",
        "/dac",
        "/vehicle/fix",
        "/vehicle/position",
    ]


def test_a_run_that_a_contradiction_stops_says_so_in_its_answer(ocean, tmp_path):
    done, answer = invoked(
        ocean,
        faulty(ocean, "profiles: both signs"),
        tmp_path,
        '[consistency]\non_failure = "stop"\n',
    )
    assert (done.exit_code, answer["exit_code"], answer["exit_codes"], answer["status"]) == (
        3,
        3,
        [3, 6],
        "failed",
    )
    assert [finding["name"] for finding in answer["consistency"]] == [
        "two sources of the current contradict each other"
    ]
    assert answer["error"] in done.stderr
    assert answer["error"].startswith("two sources of the current contradict each other (since ")
    assert answer["messages"][0]["topic"] == "/adcp"
    assert not (tmp_path / "out.mcap").exists()


def test_a_run_without_a_usable_profile_says_what_is_dead(ocean, tmp_path):
    done, answer = invoked(
        ocean, faulty(ocean, "all zero"), tmp_path, "[measurements]\nwithout = ['dac']\n"
    )
    assert (done.exit_code, answer["exit_codes"]) == (3, [3, 6])
    assert re.search(rf"{PINGS} ADCP pings, none usable: .* bins dead.*power", answer["error"])
    assert [finding["name"] for finding in answer["consistency"]] == ["dead or stale instrument"]


def in_other_water(messages, seed):
    """Yield messages with pings in water that no forecast has: at each the whole profile is pushed by some 0.3 m/s of its own.

    Mean currents, which would contradict these, are left out.
    """
    rng = np.random.default_rng(seed)
    for message in messages:
        if message.topic == "/dac":
            continue
        if message.schema == "replay_kit.AdcpPing":
            push = rng.normal(0.0, 0.3, 2)
            pairs = (zip(cell, (*push, 0.0), strict=True) for cell in message.payload["velocity"])
            cells = [
                [None if part is None else part + more for part, more in pair] for pair in pairs
            ]
            message = message._replace(payload={**message.payload, "velocity": cells})
        yield message


@pytest.mark.parametrize(
    ("place", "name", "code"), [(False, findings.MISFIT, 6), (True, findings.MISFIT_OF_MOVED, 0)]
)
def test_a_forecast_that_does_not_fit_is_told_apart_from_a_fault_of_the_log(
    ocean, tmp_path, place, name, code
):
    log = tmp_path / "other.mcap"
    write_mcap_log(log, list(in_other_water(open_log(ocean / "glider.mcap").messages(), 0)))
    summary = run(ocean, log, with_settings(forecast={"place": place}))
    (finding,) = summary.consistency
    assert (finding["name"], finding["severity"], summary.exit_code) == (
        name,
        "warning" if place else "misfit",
        code,
    )
    beyond, total = (int(word) for word in finding["evidence"].split() if word.isdigit())
    assert (total, beyond > 40) == (54, True)
    assert (
        summary.basis[1] == f"the log does not contradict itself, but {name}: {finding['evidence']}"
    )
    assert finding_line(finding).startswith(f"{'WARNING' if place else 'MISFIT'}: {name}: ")
    shown = found_warnings(Contents(read_result(ocean / "out.mcap")))
    wrong = [text for kind, text in shown if kind != "note"]
    assert [
        f"{name[:1].upper()}{name[1:]}: {finding['evidence']}; {finding['set']}." in text
        for text in wrong
    ].count(True) == 1


@pytest.mark.parametrize(
    ("gated", "used", "name"),
    [
        (10, 5, findings.MISFIT),
        (9, 6, ENSEMBLE),
        (7, 27, ENSEMBLE),
        (4, 8, None),
        (2, 0, ENSEMBLE),
        (3, 0, findings.MISFIT),
    ],
)
def test_two_thirds_of_the_observations_beyond_the_gate_are_a_misfit(gated, used, name):
    counts = Counts(gated=gated, total=Sums(profiles=used))
    found, _ = conclusions(MonitoringState(), counts, RunConfig())
    assert [finding.name for finding in found] == ([] if name is None else [name])
    # what the log says against itself explains it
    of_log = Finding(COMPASS, 0, "", "", "")
    known = MonitoringState(findings=(of_log,))
    assert conclusions(known, counts, RunConfig())[0] == (of_log,)


@pytest.mark.parametrize(
    ("decisions", "named"),
    [
        ({"profiles": (100, 2), "dac": (15, 14)}, True),
        ({"profiles": (100, 90), "dac": (15, 0)}, True),
        ({"profiles": (100, 2), "dac": (15, 4)}, False),
        ({"profiles": (100, 60), "dac": (15, 12)}, False),
        ({"dac": (15, 14)}, False),
    ],
)
def test_a_gate_that_rejects_most_of_one_source_names_both(decisions, named):
    found, _ = conclusions(MonitoringState(decisions=decisions), Counts(), RunConfig())
    assert [one.name for one in found] == [findings.PREFERRED] * named
    if named:
        assert "the profiles" in found[0].cause
        assert "mean currents of dives" in found[0].cause


@pytest.mark.parametrize(
    ("reason", "used", "named"),
    [
        (TOO_FAST, 0, {SCALE: "12 of 12 mean currents were skipped"}),
        (THROWN, 36, {}),
        (THROWN, 35, {findings.MIXED: "12 of 47 positions are out of the vehicle"}),
    ],
)
def test_messages_of_which_too_many_are_skipped_are_named(reason, used, named):
    counts = Counts({"/x": used}, {("/x", reason): 12, ("/y", "other"): 3})
    found, _ = conclusions(MonitoringState(), counts, RunConfig())
    assert [one.name for one in found] == [*named]
    assert all(one.evidence.startswith(named[one.name]) for one in found)


def test_what_would_tell_whether_directions_are_right_is_said():
    for pings in (9, 0):
        (said,) = conclusions(
            MonitoringState(Checked(pings=(pings, pings))), Counts(), RunConfig()
        )[1]
        assert said.startswith("nothing here can tell whether directions are right; profiles ")


@pytest.mark.parametrize("pings", [0, 1])
def test_frozen_positions_explain_that_no_profile_may_be_used_where_there_is_one(pings):
    frozen = Finding(FROZEN, 0, "", "", "")
    state = MonitoringState(Checked(pings=(pings, pings)), (frozen,))
    assert state.explains_no_profile == (pings > 0)


@pytest.mark.full
def test_a_run_stopped_around_a_finding_gives_the_same_bytes(ocean, tmp_path):
    log = faulty(ocean, "profiles: both signs")
    job = ReplayJob((log,), ocean / "ensemble.nc", tmp_path / "out.mcap")
    assert goes_on(job, often(CONFIG), 60, 40).exit_code == 6
