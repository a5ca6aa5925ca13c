"""The page of a short replay: what is in it, without a browser."""

import json
import re
from html import unescape

import numpy as np
import pytest

import replay_kit as rk
from replay_kit.core.geodesy import to_local
from replay_kit.results.outcome.outcome import leaves
from replay_kit.show.numbers import Shown
from replay_kit.show.sentences import estimate_sentences, flown_sentences, trust_sentences
from replay_kit.show.status.held import read_held
from replay_kit.show.status.lines import lines
from replay_kit.show.status.status import status_of
from tests.show.page.checks import check_figures
from tests.show.report.conftest import page_of
from tests.show.report.html_of import elements, figures, text_of, track_of, unpacked

#: Figures of a status that are numbers of the summary.
KNOWN = ["map", "answer", "section", "trust", "plan", "again"]
KEYS = [
    *("current-map", "profiles", "mean-currents", "innovations", "dives", "error", "calibration"),
    *("plan-profile", "surfacing-errors"),
]


def test_the_sections_are_an_answer_from_top_to_bottom(page):
    assert [attrs["id"] for attrs, _ in elements(page, "section")] == KNOWN
    links = [attrs["href"] for attrs, _ in elements(page, "a")]
    assert links[: len(KNOWN)] == [f"#{key}" for key in KNOWN]


def test_every_figure_has_caption_text_alternative_data_and_units_and_nothing_is_fetched(page):
    assert [key for key in check_figures(page) if key in KEYS] == KEYS


def test_the_same_result_gives_the_same_page_and_it_is_small(page, replayed):
    assert page_of(replayed) == page
    assert len(page) < 4e6
    assert str(replayed.path.parent) not in page


def test_every_number_of_page_summary_and_status_is_one_of_json(page, replayed):
    outcome = replayed.outcome
    expected = {
        path: value for path, value in leaves(outcome.to_json()) if not path.startswith("seconds.")
    }
    numbers = {
        path: value
        for path, value in expected.items()
        if isinstance(value, int | float) and not isinstance(value, bool)
    }
    said = [*estimate_sentences(outcome), *flown_sentences(outcome), *trust_sentences(outcome)]
    carried = [part for each in said for part in each.parts if not isinstance(part, str)]
    status = status_of(read_held(replayed.reader))
    expected |= {f"status.{path}": value for path, value in leaves(status.figures)}
    carried += [
        part._replace(key=f"status.{part.key}")
        for line in lines(status)
        for part in line.said.parts
        if not isinstance(part, str)
    ]
    carried += [
        Shown(attrs["data-key"] or "", json.loads(attrs["value"] or ""), text)
        for attrs, text in elements(page, "data")
    ]
    for key, value, text in carried:
        path, _, part = key.partition("#")
        # a leg is text of its own in the summary
        assert value == (json.loads(expected[path])[part] if part else expected[path]), key
        assert "-0.0" not in text.replace("-0.0", "x", 0) or float(text.split()[0]) != 0.0, key
        _check_rounded(key, value, text)
    whole = {each.key for each in carried if "#" not in each.key}
    assert {key for key in whole if not key.startswith("status.")} == set(numbers)


def test_no_number_of_the_outcome_stands_on_the_page_without_its_field(page, replayed):
    """Texts of the outcome, such as the plan's message, are fields themselves."""
    whole = replayed.outcome.to_json()
    # wall times are others in each run, and may be any number by chance
    outcome = [value for _, value in leaves(whole | {"seconds": {}})]
    shown = page.split('<section id="again"', 1)[0].split("<body", 1)[1]
    for without in (r"<(script|style|svg)\b.*?</\1>", r"<data\b.*?</data>", r"<[^>]+>"):
        shown = re.sub(without, " ", shown, flags=re.DOTALL)
    words = " ".join(unescape(shown).split()).lower()
    texts = [each for each in outcome if isinstance(each, str)]
    # earlier plans are none of the outcome
    texts += list(replayed.plans["message"])
    for text in sorted(texts, key=len, reverse=True):
        words = words.replace(" ".join(text.split()).lower(), "")
    plain = [*re.finditer(r"(?<![\w.,:-])\d[\d,]*\.?\d*(?![\w:-])", words)]
    rounded = {
        text
        for value in outcome
        if isinstance(value, float) and np.isfinite(value)
        for text in (
            f"{100.0 * value:.1f}",
            f"{100.0 * value:.2f}",
            f"{value:.2f}",
            f"{value:,.1f}",
        )
        # others are there by chance
        if len(text) > 3
    }
    assert len(rounded) > 50
    assert [
        words[max(one.start() - 60, 0) : one.end() + 20] for one in plain if one[0] in rounded
    ] == []


def _check_rounded(key: str, value: float, text: str) -> None:
    """Check that a text is the number in its unit, rounded to the digits that it shows."""
    shown, _, unit = text.replace(",", "").partition(" ")
    if re.search(r"[A-Za-z]{3}", unit):
        # a time of the clock
        return
    factors = {"cm/s": 100.0, "%": 100.0, "kJ": 1e-3, "MJ": 1e-6}
    digits = len(shown.partition(".")[2]) if "e" not in shown else 17
    # where no unit stands beside it, it is that of the summary, cm/s, km, or hours of a leg or of days
    wanted = [factors[unit]] if unit in factors else [1.0, 100.0, 1e-3, 1.0 / 3600.0, 24.0]
    error = min(abs(abs(float(shown)) - factor * abs(value)) for factor in wanted)
    # six digits in the table of all numbers
    assert error <= max(0.5000001 * 10.0**-digits, 1e-5 * abs(value)), (key, value, text)


def test_words_say_what_was_measured_found_and_not_used(page, replayed):
    words, summary = " ".join(text_of(page, "answer").split()), replayed.outcome
    trust = " ".join(text_of(page, "trust").split())
    said = [*estimate_sentences(summary), *trust_sentences(summary)]
    assert all(str(each) in f"{words} {trust}" for each in said)
    card = "".join(text_of(page, "map").split())
    assert f"{round(summary.plan['heading_deg']) % 360:03d}°" in card
    assert f"{100.0 * summary.plan['odds']['reached']:.0f}%of4samples" in card


def test_charts_of_trust_are_of_the_bins(page, replayed):
    found, bins = figures(page), rk.open_result(replayed.path).innovations
    histogram = found["calibration"]["panels"][0]["marks"][0]
    width = np.diff(histogram["x"][:2])
    assert np.sum(histogram["y"]) * width == pytest.approx(1.0, abs=1e-3)
    marks = found["innovations"]["panels"][0]["marks"]
    shown = next(mark["y"] for mark in marks if mark["name"].endswith("expected RMS"))
    topics = rk.open_result(replayed.path).observations["source_topic"]
    first = int(np.flatnonzero(topics == topics.iloc[0])[0])
    used = bins[np.isfinite(bins["innovation_east"]) & (bins["observation"] == first)]
    squares = used[["innovation_std_east", "innovation_std_north"]].to_numpy() ** 2
    assert shown[0] == pytest.approx(np.sqrt(squares.mean()), rel=1e-4)


def test_the_map_holds_the_published_current(page, replayed):
    figure = figures(page)["current-map"]
    current = unpacked(figure["packed"]["current"])
    mean, *depths = figure["choices"][1]
    assert depths == ["5 m", "150 m"]
    flow = replayed.estimate
    drawn = figure["map"]
    east, north = np.meshgrid(np.array(drawn["east"]) * 1e3, np.array(drawn["north"]) * 1e3)
    got = np.moveaxis(current[2, -1], 0, -1)
    wet = np.isfinite(got[..., 0])
    np.testing.assert_allclose(got[wet][:, :2], flow.velocity(east, north, 150.0)[wet], atol=3e-4)
    known = np.isfinite(got[..., 2])
    np.testing.assert_allclose(
        got[known][:, 2:], flow.standard_error(east, north, 150.0)[known], atol=3e-4
    )
    deep = float(mean.split()[-2])
    below = deep * (np.arange(200) + 0.5) / 200
    each = np.mean([flow.velocity(east, north, depth) for depth in below], axis=0)
    mean = np.moveaxis(current[0, -1], 0, -1)
    np.testing.assert_allclose(mean[wet][:, :2], each[wet], atol=2e-3)
    places = replayed.fixes[["longitude", "latitude"]].to_numpy().T
    expected = np.stack(to_local(flow.grid.projection, *places)) / 1e3
    track = track_of(page)
    np.testing.assert_allclose([track["x"], track["y"]], expected, atol=6e-4)
