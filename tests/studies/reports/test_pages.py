"""The pages of the studies: what they say and show of results that are written down."""

from dataclasses import replace

import numpy as np
import pytest

from replay_kit import __version__
from replay_kit.show.figures.on_page import log_ticks
from replay_kit.show.figures.values import Axis, Mark, Panel
from replay_kit.studies.bench import page as bench
from replay_kit.studies.reports.page import chart_figure, misses_chart, one_chart, words_html
from replay_kit.studies.reports.tables import Table, to_csv
from tests.show.page.checks import check_figures
from tests.show.report.html_of import elements, table, text_of
from tests.studies.pages import bench_result


def test_a_page_lies_beside_the_tables_and_is_whole(tmp_path):
    bench.report_of(bench_result()).write(tmp_path)
    page = (tmp_path / "index.html").read_text()
    assert list(check_figures(page)) == [
        f"{task}-{k}"
        for task, n in (("pings", 2), ("next-dive", 3), ("outliers", 2))
        for k in range(n)
    ]
    assert [attrs["href"] for attrs, _ in elements(page, "a")] == [
        f"#{attrs['id']}" for attrs, _ in elements(page, "section")
    ]
    ids = [attrs["id"] for tag in ("section", "figure") for attrs, _ in elements(page, tag)]
    assert len(set(ids)) == len(ids)
    assert ["replay-kit", __version__] in table(page, "Versions")
    assert ["ensemble", "ensemble.nc"] in table(page, "Inputs and options")
    assert len(page) < 1e6
    (csv,) = tmp_path.glob("*.csv")
    assert csv.read_text().count("\n") > 3
    (tmp_path / "again").mkdir()
    bench.report_of(bench_result()).write(tmp_path / "again")
    assert (tmp_path / "again" / "index.html").read_text() == page


def test_an_unfinished_study_has_no_page(tmp_path):
    bench.report_of(replace(bench_result(), unfinished=True)).write(tmp_path)
    assert sorted(path.suffix for path in tmp_path.iterdir()) == [".csv", ".json"]


def test_the_page_says_what_errs_least_what_is_missing_and_what_keeps_to_no_limit() -> None:
    page = bench.bench_page(bench_result())
    words = text_of(page, "answer")
    assert "pings, 5 pings: 2.5D default errs least, relative error 0.400 [0.39, 0.41]" in words
    assert "next-dive: process errs least, over last dive 0.741 [0.6703, 0.8187]" in words
    assert "pings, seed 0, etkf after 50 pings: LinAlgError: <singular>." in words
    assert "<singular>" not in page.split("<script")[0]
    assert "1 of 2 criteria are met; these are not:" in words
    assert "outliers, gate soften, RMSE over clean: 1.2, required <= 1.05" in words
    assert text_of(page, "outliers").count("NOT MET") == 1
    figures = check_figures(page)
    assert figures["pings-1"]["tables"]["values"] == {
        "2.5D default: pings": [5.0, 50.0],
        "2.5D default: NIS per degree of freedom [1]": [1.1, 1.1],
    }
    held = figures["next-dive-2"]["tables"]["values"]
    assert held["each case: coverage 90 % [1]"] == [0.25, 0.875]
    assert held["all cases: coverage 90 % [1]"][0] == 0.5625
    # the same error in both missions: all that were sampled again have it
    (rms,) = (row for row in bench_result().rows if row.figure == "RMS error [cm/s]")
    assert (rms.value, rms.low, rms.high, rms.by_case) == (3.0, 3.0, 3.0, (3.0, 3.0))


def test_a_chart_says_its_data_in_words_and_fills_short_series():
    pings, error = Axis("pings", log=True), Axis("error [m/s]")
    lines = [
        Mark("joined", np.array([1.0, 10.0, 100.0]), np.array([3.0, np.nan, 1.0]), "a.b"),
        Mark("joined", np.array([2.0]), np.array([5.0]), "c"),
        Mark("joined", np.array([np.nan]), np.array([np.nan]), "none"),
    ]
    panel = Panel("Title", error, lines, level=0.5)
    figure = chart_figure(one_chart("key", "Title", "What to see.", pings, panel))
    assert (
        figure.alternative
        == "Title: error [m/s] against pings. a.b: 3 at 1 to 1 at 100. c: 5 at 2. none: no values."
    )
    assert figure.tables["values"]["c: pings"] == [2.0, None, None]
    assert figure.tables["values"]["a.b: error [m/s]"] == [3.0, None, 1.0]
    assert figure.traces[0]["x"] == "$values.a.b: pings"
    assert figure.layout["xaxis"]["type"] == "log"
    assert figure.layout["xaxis"]["ticktext"] == [
        "0.5",
        "1",
        "2",
        "5",
        "10",
        "20",
        "50",
        "100",
        "200",
    ]
    assert figure.layout["shapes"][0]["y0"] == 0.5
    assert (
        len({(str(trace["line"]["color"]), trace["marker"]["symbol"]) for trace in figure.traces})
        == 3
    )
    # a method has the colour of its place among those of the page
    alone = one_chart("k", "T", "C", pings, Panel("T", error, lines[1:2]))
    alone = chart_figure(alone, ["a.b", "c"])
    assert alone.traces[0]["line"] == figure.traces[1]["line"]
    assert alone.traces[0]["line"] != figure.traces[0]["line"]
    name = Axis("name", labels=("first", "second"))
    dots = Mark("points", np.array([1.0, 2.0]), np.array([1.0, 0.0]), "s")
    named = chart_figure(one_chart("k", "T", "C", Axis("value [1]"), Panel("T", name, [dots])))
    assert named.alternative == "T: name against value [1]. s: second 1; first 2."
    # the first of the names is at the top
    assert named.layout["yaxis"]["ticktext"] == ["first", "second"]
    assert named.layout["yaxis"]["range"] == [1.5, -0.5]


@pytest.mark.parametrize(
    ("least", "largest", "expected"),
    [
        (3.0, 30.0, [2.0, 5.0, 10.0, 20.0, 50.0]),
        (0.8, 1.3, [0.4, 0.5, 0.6, 0.8, 1.0, 1.2, 1.5, 2.0]),
        (1.0, 1e6, [1.0, 10.0, 100.0, 1e3, 1e4, 1e5, 1e6]),
    ],
)
def test_a_logarithmic_axis_has_round_ticks(least, largest, expected):
    assert log_ticks(np.array([0.0, largest, np.nan, least, np.inf])) == expected


def test_words_are_escaped_and_marked():
    assert words_html(["*a* < `b` & c_d"]) == "<p><em>a</em> &lt; <code>b</code> &amp; c_d</p>"


def test_misses_of_no_plan_are_no_line():
    (line,) = misses_chart("k", "t", {"flow": [5.0]}).panels[0].marks
    assert (line.x.tolist(), line.y.tolist()) == ([5.0, 5.0], [0.0, 1.0])
    (line,) = misses_chart("k", "t", {"flow": [8.0, 4.0]}).panels[0].marks
    assert line.x.tolist() == [4.0, 4.0, 8.0, 8.0]
    assert line.y.tolist() == [0.0, 0.5, 0.5, 1.0]
    assert misses_chart("k", "t", {}).caption.endswith("distances below 1 m are drawn at 1 m.")


def test_a_text_is_no_formula_in_a_table_as_csv():
    table = Table(
        "names",
        "Names",
        ("=name", "value"),
        (("@SUM(1)", -1.5), ("plain", (-1.0, 2.0)), ("+1", float("nan"))),
    )
    assert to_csv(table) == "'=name,value\n'@SUM(1),-1.5\nplain,-1.0 2.0\n'+1,\n"
