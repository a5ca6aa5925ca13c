"""The page of a short replay: what is in it, without a browser."""

import json

import numpy as np

import replay_kit as rk
from replay_kit.results.outcome.from_run import outcome_of
from replay_kit.results.views.record import leaves
from replay_kit.show.report import report_html
from replay_kit.show.report.page import SECTIONS
from tests.show.page.checks import check_figures
from tests.show.report.html_of import elements, figures, text_of, unpacked

KNOWN = ["answer", "map", "section", "trust", "plan", "again"]
KEYS = [
    *("current-map", "profiles", "mean-currents", "innovations", "calibration", "error", "dives"),
    *("plan-profile", "waypoint", "surfacing-errors"),
]


def test_the_sections_are_an_answer_from_top_to_bottom(page: str) -> None:
    keys = [attrs["id"] for attrs, _ in elements(page, "section")]
    assert [key for key in keys if key in KNOWN] == KNOWN
    assert (keys[0], keys[-1], len(keys)) == ("answer", "again", len(SECTIONS))
    links = [attrs["href"] for attrs, _ in elements(page, "a")]
    assert links == [f"#{attrs['id']}" for attrs, _ in elements(page, "section")]
    titles = [text for _, text in elements(page, "h3")][:7]
    assert titles[:2] == ["How far to trust it", "What was measured"]
    assert titles[6] == "What to do next"


def test_every_figure_has_caption_text_alternative_data_and_units_and_nothing_is_fetched(
    page: str,
) -> None:
    assert [key for key in check_figures(page) if key in KEYS] == KEYS
    assert all(len(text) > 60 for _, text in elements(page, "figcaption"))


def test_the_same_result_gives_the_same_page_and_it_is_small(
    page: str, replayed: rk.Result
) -> None:
    assert report_html(rk.open_result(replayed.path)) == page
    assert len(page) < 4e6
    assert str(replayed.path.parent) not in page


def test_the_numbers_are_those_of_json(page: str, replayed: rk.Result) -> None:
    assert replayed.summary is not None
    expected = {
        path: value
        for path, value in leaves(outcome_of(replayed.summary).to_json())
        if not path.startswith("seconds.")
    }
    numbers = {
        path: value
        for path, value in expected.items()
        if isinstance(value, int | float) and not isinstance(value, bool)
    }
    assert len(numbers) > 40
    carried: dict[str, set[str]] = {}
    for attrs, text in elements(page, "data"):
        value = json.loads(attrs["value"] or "")
        assert value == expected[attrs["data-key"] or ""], attrs
        carried.setdefault(attrs["data-key"] or "", set()).add(text)
        shown, _, unit = text.replace(",", "").partition(" ")
        factor = {"cm/s": 100.0, "%": 100.0, "kJ": 1e-3, "MJ": 1e-6}.get(unit, 1.0)
        if attrs["data-key"] != "surfacings.delay_median_s":
            digits = len(shown.partition(".")[2]) if "e" not in shown else 17
            assert abs(float(shown) - factor * value) <= 0.5000001 * 10.0**-digits, attrs
    assert set(carried) == set(numbers)
    assert all(
        str(value) in text_of(page, "again")
        for value in expected.values()
        if isinstance(value, str)
    )


def test_words_say_what_was_measured_found_and_not_used(page: str, replayed: rk.Result) -> None:
    words, summary = " ".join(text_of(page, "answer").split()), replayed.summary
    assert summary is not None
    means = summary.mean_currents
    assert means > 1
    values = f"{summary.bins_used:,} values: {means} mean currents, {summary.bins_used - means:,} depth bins of profiles"
    assert (
        f"gave {summary.profiles_used} measurements of the current that were used ({values}), on 3 dives"
        in words
    )
    change = 100.0 * (1.0 - summary.rms_before / summary.rms_prior)
    assert f"differed from it by {100 * summary.rms_before:.2f} cm/s (RMS of a component)" in words
    assert f"the estimate is {change:.0f} % closer" in words
    assert f"per degree of freedom is {summary.nis_per_dof:.2f}" in words
    assert summary.profiles_rejected == 1
    assert "1 measurement was rejected as a whole. Bins not used" in words
    assert f"{summary.bins_rejected['below_grid']:,} below grid" in words
    assert summary.plan is not None
    assert f"teer {summary.plan.heading_deg:.0f}° true through water" in words
    assert "The estimated current at the last position" in words


def test_the_map_holds_the_published_current(page: str, replayed: rk.Result) -> None:
    figure = figures(page)["current-map"]
    current, axes = unpacked(figure["packed"]["current"]), figure["tables"]["current"]["axes"]
    assert axes["depth_m"] == [5.0, 150.0]
    assert figure["choices"][1] == ["5 m", "150 m"]
    assert len(axes["time"]) == current.shape[1] == len(figure["choices"][2]) == 5
    flow = replayed.estimate
    field = figure["traces"][0]
    east, north = np.meshgrid(np.array(field["x"]) * 1e3, np.array(field["y"]) * 1e3)
    got = np.moveaxis(current[1, -1], 0, -1)
    wet = np.isfinite(got[..., 0])
    np.testing.assert_allclose(got[wet][:, :2], flow.velocity(east, north, 150.0)[wet], atol=3e-4)
    known = np.isfinite(got[..., 2])
    np.testing.assert_allclose(
        got[known][:, 2:], flow.standard_error(east, north, 150.0)[known], atol=3e-4
    )
    names = [trace.get("name") for trace in figure["traces"]]
    assert {"track", "fixes", "last plan", "goal"} <= set(names)
    track = figure["tables"]["track"]
    assert len(track["time"]) == len(replayed.fixes)
    np.testing.assert_allclose(track["longitude"], replayed.fixes["longitude"], atol=1e-6)


def test_the_command_and_settings_are_named(page: str) -> None:
    text = text_of(page, "again")
    assert (
        "replay-kit replay glider.mcap --ensemble ensemble.nc --config config.toml --goal=153.05,-40.2,150.0 -o short.mcap"
        in text
    )
    codes = [text for _, text in elements(page, "code")]
    assert {"estimator.modes", "forecast.levels", "logs.end", "output.interval"} <= set(codes)
    assert "estimator.prior" not in codes
    assert sum(len(code) == 64 for code in codes) == 2
