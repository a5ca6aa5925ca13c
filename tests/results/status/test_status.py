"""A result on one screen: each answer against what was put in, and what wakes a person."""

import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from pyproj import Geod

from replay_kit.results.status import figures
from replay_kit.results.status.alarms import alarms_of
from replay_kit.results.status.change import change_of
from replay_kit.results.status.held import Fix, _positions
from replay_kit.results.status.page import status_page
from replay_kit.results.status.status import status_of
from replay_kit.results.status.text import age_text, status_text
from tests.places import ROOT
from tests.results.status.held_samples import HOUR_NS, START_NS, held, mean_current, plan

END_NS = START_NS + 48 * HOUR_NS


def kinds(values, now_ns=END_NS):
    return [alarm.kind for alarm in alarms_of(values, now_ns)]


def test_what_is_made_good_is_how_much_nearer_the_goal_came_a_day():
    day, mission = figures.made_good(held())
    geod = Geod(ellps="WGS84")
    begin, before, end = (
        geod.inv(longitude, 62.0, 5.5, 62.0)[2] / 1e3 for longitude in (4.65, 4.9, 5.0)
    )
    assert (day.days, mission.days) == (pytest.approx(25.0 / 24.0), pytest.approx(2.0))
    assert day.km_a_day == pytest.approx((before - end) / day.days)
    assert mission.km_a_day == pytest.approx((begin - end) / 2.0)
    assert mission.error == pytest.approx(0.02 * 2.0**0.5 / 2.0)


@pytest.mark.parametrize("seed", range(6))
def test_positions_held_are_the_first_the_last_one_a_day_before_and_where_it_was_reckoned_since(
    seed, monkeypatch
):
    rng = np.random.default_rng(seed)
    said = [
        Fix(int(time), float(k), -5.0, bool(rng.random() < 0.6))
        for k, time in enumerate(np.sort(rng.integers(0, 60, 9)) * HOUR_NS)
    ]

    def message(fix):
        return SimpleNamespace(
            longitude=fix.longitude,
            latitude=-5.0,
            metadata=[SimpleNamespace(key="dead_reckoned", value=f"{fix.reckoned:d}")],
        )

    monkeypatch.setattr(
        "replay_kit.results.status.held.read_messages",
        lambda path, topic: [(fix.time_ns, message(fix)) for fix in said],
    )
    monkeypatch.setattr(
        "replay_kit.results.status.held.DecoderFactory.decoder_for",
        lambda factory, encoding, schema: lambda data: data,
    )
    fixes, reckoned = _positions(Path("r.mcap"), "schema")
    measured = [fix for fix in said if not fix.reckoned]
    day_before = [fix for fix in measured if measured[-1].time_ns - fix.time_ns >= 24 * HOUR_NS]
    assert fixes == [measured[0], *day_before[-1:], measured[-1]]
    assert reckoned == (
        said[-1] if said[-1].reckoned and said[-1].time_ns > measured[-1].time_ns else None
    )
    said = [replace(fix, reckoned=True) for fix in said]
    assert _positions(Path("r.mcap"), "schema") == ([], said[-1])
    assert _positions(Path("r.mcap"), None) == ([], None)


def test_a_vehicle_without_goal_or_way_makes_nothing_good():
    assert figures.made_good(held(plans=[])) == []
    assert figures.made_good(held(fixes=held().fixes[-1:])) == []


def test_the_current_of_the_last_dive_stands_beside_the_estimate_s():
    found = figures.dive_current(held())
    assert found.measured.toward == pytest.approx(90.0, abs=0.1)
    assert found.difference == pytest.approx(0.1)
    assert found.expected == pytest.approx(0.02)
    assert figures.dive_current(held(dive=[])) is None


def test_a_surfacing_is_overdue_by_a_share_of_its_leg_and_the_next_leg_comes_after_a_surfacing():
    following = figures.next_surfacing(held())
    assert following.time_ns == END_NS + 4 * HOUR_NS
    assert following.margin_s == pytest.approx(0.2 * 14_400.0)
    on_time, late = following.time_ns + int(2879e9), following.time_ns + int(2881e9)
    assert "surfacing overdue" not in kinds(held(), on_time)
    assert "surfacing overdue" in kinds(held(), late)
    surfaced = held().outcomes[0]
    surfaced.planned_time.FromNanoseconds(END_NS)
    assert figures.next_surfacing(held(outcomes=[surfaced])).time_ns == END_NS + 8 * HOUR_NS
    assert figures.next_surfacing(held(outcomes=[surfaced, surfaced])) is None


def test_each_alarm_is_given_for_its_cause_alone():
    assert kinds(held()) == []
    outside = held().outcomes[0]
    outside.inside_ellipse = False
    assert kinds(held(outcomes=[outside])) == ["outside its ellipse"]
    finding = {
        "name": "headings",
        "evidence": "off by 90",
        "set": "check the mounting",
        "severity": "inconsistent",
    }
    assert kinds(held(summary={"consistency": [finding]})) == ["consistency"]
    for status in ("unsafe", "uncertain", "failed", "unreachable", "reached"):
        assert kinds(held(plans=[plan(END_NS, status=status)])) == (
            ["plan"] if status in ("unsafe", "uncertain", "failed") else []
        )
    assert kinds(held(plans=[]), END_NS + 60 * HOUR_NS) == ["forecast ended"]
    static = {
        "replay_kit.forecast": {
            "first": "2023-11-14T00:00:00Z",
            "last": "2023-11-14T00:00:00Z",
            "evolves": "false",
        }
    }
    assert kinds(held(plans=[], metadata=static), END_NS + 60 * HOUR_NS) == []


def test_a_change_of_the_command_is_told_with_its_reasons():
    (change,) = change_of(held())
    # the plan before would steer its second leg now
    assert "was 60°: 20° to the right" in change
    assert "3.5 km toward 270°" in change
    assert "the current differed 10 cm/s" in change
    moved = plan(
        END_NS, goal={"longitude": 6.0, "latitude": 62.0, "depth": 0.0}, status="uncertain"
    )
    (change,) = change_of(held(plans=[held().plans[0], moved]))
    assert "the goal moved 26.2 km" in change
    assert "was reached and is uncertain" in change
    quiet = held(
        plans=[plan(END_NS - HOUR_NS), plan(END_NS)],
        outcomes=[],
        dive=[mean_current(END_NS, (0.01, 0.0), (0.0, 0.0), 0.02)],
    )
    assert change_of(quiet) == ("unchanged since the plan before",)
    assert change_of(held(plans=held().plans[-1:])) == ()


def test_the_screen_is_80_columns_wide_and_says_how_old_each_answer_is():
    text = status_text(status_of(held(), END_NS + 3 * HOUR_NS))
    assert max(map(len, text.splitlines())) <= 80
    for label in (
        "Position",
        "Made good",
        "Current",
        "Surfacing",
        "Steer",
        "Odds",
        "Forecast",
        "Fit",
    ):
        assert (
            re.search(
                rf"^{label} +3.0 h |^{label} +\d+\.\d d |^{label} +\d+ h ", text, re.MULTILINE
            )
            or label == "Forecast"
        ), label
    assert "90 ± 9 % of 10 samples arrive" in text
    assert "250 kJ of 1000 kJ" in text
    assert "± 20 m" in text
    assert [age_text(seconds) for seconds in (0.0, 120.0, 7200.0, -7200.0, 864_000.0)] == [
        "now",
        "2 min",
        "2.0 h",
        "in 2.0 h",
        "10.0 d",
    ]


def test_the_page_holds_the_same_answers_loads_itself_again_and_runs_nothing_of_a_log_s():
    status = status_of(
        held(
            name="<script>x</script>.mcap",
            plans=[plan(END_NS, status="unsafe", message="<b>crosses</b>")],
        )
    )
    page = status_page(status, 30)
    assert '<meta http-equiv="refresh" content="30">' in page
    assert "<script" not in page
    assert "&lt;b&gt;crosses&lt;/b&gt;" in page
    assert page.count("<section") == len(status.lines)
    assert '<section id="odds" class="alarm">' in page


def test_figures_are_numbers_for_json():
    figures_held = status_of(held()).figures
    assert figures_held["position"]["error_m"] == 20.0
    assert figures_held["odds"]["reached"] == 0.9
    assert figures_held["surfacing"]["next"]["major_m"] == 2000.0
    assert (
        status_of(held(plans=[], fixes=[], dive=[], outcomes=[], summary={})).figures["alarms"]
        == []
    )


def test_nothing_heavy_is_loaded_and_a_file_that_is_no_result_is_refused():
    code = (
        "import sys\nfrom replay_kit.cli.app import main\n"
        "try: main()\nexcept SystemExit as done: print(done.code)\n"
        "print(sorted({'scipy', 'xarray', 'pandas', 'matplotlib', 'casadi', 'h5py', 'foxglove', 'rich'} & sys.modules.keys()))"
    )
    command = [sys.executable, "-c", code, "status", "sample_logs/glider.mcap"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == ["3", "[]"]
    assert "no result of replay-kit replay" in done.stderr
