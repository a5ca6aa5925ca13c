"""Figures: what they show and say of whole results and of such that lack something; the same bytes from the same result."""

from itertools import product

import numpy as np
import pytest
from matplotlib.figure import Figure

from replay_kit.core.errors import ConfigError
from replay_kit.core.geodesy import rotate_to_geographic, to_geographic
from replay_kit.core.words.text import time_text
from replay_kit.results.views.contents import Contents
from replay_kit.results.views.current import CurrentSlices, published_at
from replay_kit.show.figures.draw import ENDINGS, figure_bytes
from replay_kit.show.figures.kinds import KINDS, drawn_figure
from replay_kit.show.figures.map import Chosen
from replay_kit.show.figures.section import QUANTITIES, limits_of
from tests.results.cases import across_the_antimeridian, one_bin, without_estimate, write
from tests.show.figures.texts import words
from tests.synthetic_flow import synthetic_flow

AT_77 = Chosen((5.0, 62.0, 77.0))


@pytest.mark.parametrize(
    ("kind", "letters", "says"),
    [
        ("map", 2, "(b) standard error"),
        ("section", 8, "(d) estimated, northward"),
        ("series", 2, "(a) eastward, 5.0300 E, 62.0060 N, 0.5 m"),
        ("dac", 0, "The result holds no mean current of a dive"),
        ("trust", 4, "(c) innovations over their standard deviation"),
        ("plan", 2, "heading 45° true, glide angle 20.0°, 1.0 h, misses the goal by 12 m."),
    ],
)
def test_figures_have_panels_with_letters(contents, kind, letters, says):
    figure = getattr(contents.result.plot, kind)()
    titles = [axes.get_title(loc="left")[:2] for axes in figure.axes]
    found = [title for title in titles if title[:1] == "("]
    assert found == [f"({letter}" for letter in "abcdefgh"[:letters]]
    assert says in words(figure)


@pytest.mark.full
@pytest.mark.parametrize(
    ("kind", "ending"), [*product([kind for kind in KINDS if kind != "dac"], ENDINGS)]
)
def test_the_same_result_gives_the_same_bytes(contents, kind, ending):
    first, second = (
        figure_bytes(drawn_figure(Contents(contents.result), kind), ending) for _ in range(2)
    )
    assert first == second
    assert first[1:4] == {".png": b"PNG", ".svg": b"?xm", ".pdf": b"PDF"}[ending]


@pytest.mark.full
def test_a_map_across_the_antimeridian_is_continuous(tmp_path, flow, innovation, plan):
    contents = across_the_antimeridian(tmp_path / "case.mcap", flow, innovation, plan)
    axes = drawn_figure(contents, "map").axes[0]
    west, east = axes.get_xlim()
    assert 179.0 < west < 180.0 < east < 181.0
    assert axes.xaxis.get_major_formatter()(180.5) == "179.5°W"
    # as wide as its middle latitude makes a degree
    middle = np.cos(np.deg2rad(np.mean(axes.get_ylim())))
    assert axes.get_aspect() == pytest.approx(1.0 / middle, rel=1e-6)


def test_bars_of_dives_are_the_standard_errors_of_what_was_measured(tmp_path, flow, innovation):
    mean = {"mean_current": np.array([0.1, -0.2]), "mean_kind": "dac", "mean_std": 0.01}
    contents = write(tmp_path / "r.mcap", flow, [one_bin(innovation, **mean)], None)
    (bars,) = contents.result.plot.dac().axes[0].collections
    assert np.ptp(bars.get_segments()[0][:, 1]) == pytest.approx(0.02)


def test_the_library_draws_a_panel_into_axes_of_its_own(contents):
    axes = Figure().add_subplot()
    figure = contents.result.plot.trust(axes, panel=1)
    assert figure is axes.figure
    with pytest.raises(ConfigError, match="panel: expected 0 to 3, got 4; trust has 4 here"):
        contents.result.plot.trust(axes, panel=4)
    with pytest.raises(ConfigError, match="columns: expected 1 or 2, got 3"):
        contents.result.plot.map(columns=3)


@pytest.mark.parametrize(
    ("kind", "chosen", "said"),
    [
        ("maps", Chosen(), "figure: expected one of map, section, .*, plan, got 'maps'"),
        ("trust", AT_77, "--at: applies to map, series, plan, not to trust"),
        ("series", Chosen(depth=9.0), "--depth: applies to map, plan, not to series"),
        ("plan", Chosen(time_ns=1), "--time: applies to map, not to plan"),
        ("map", AT_77._replace(depth=9.0), "--depth: --at states a depth already"),
    ],
)
def test_what_a_figure_does_not_have_is_refused(contents, kind, chosen, said):
    with pytest.raises(ConfigError, match=said):
        drawn_figure(contents, kind, chosen)


def test_the_place_and_depth_asked_for_are_those_of_map_and_series(
    contents, tmp_path, flow, innovation, plan
):
    assert "(a) 77 m, " in words(drawn_figure(contents, "map", AT_77))
    said = words(drawn_figure(contents, "series", AT_77))
    assert "(a) eastward, 5.0000 E, 62.0000 N, 77 m" in said
    far = words(drawn_figure(contents, "series", Chosen((6.0, 62.0, 10.0))))
    assert "is on land, below the bottom, or outside the region" in far
    lacking = without_estimate(tmp_path / "case.mcap", flow, innovation, plan)
    nearest = "Requested depth: 77 m; nearest published depth: 120 m."
    assert nearest in words(drawn_figure(lacking, "series", AT_77))


@pytest.mark.full
def test_a_map_of_a_time_has_the_current_published_before_it_and_nothing_later(contents):
    times, track = contents.slices.time_ns, contents.track
    moment = int(times[1]) + 1
    figure = drawn_figure(contents, "map", Chosen(depth=100.0, time_ns=moment))
    assert f"(a) 120 m, {time_text(int(times[1]))[:16]}" in words(figure)
    whole, part = (
        next(line for line in each.axes[0].lines if line.get_label() == "track").get_ydata()
        for each in (drawn_figure(contents, "map"), figure)
    )
    seen = int(np.searchsorted(track.time_ns, moment, "right"))
    assert 0 < seen < track.time_ns.size == len(whole)
    np.testing.assert_allclose(part, track.latitude[:seen])
    with pytest.raises(ConfigError, match="no current was published before"):
        drawn_figure(contents, "map", Chosen(time_ns=int(times[0]) - 1))


@pytest.mark.parametrize(("depth", "published"), [(77.0, False), (120.0, True), (120.4, True)])
def test_a_series_is_that_of_its_place_and_not_of_the_cell_about_it(contents, depth, published):
    place = (5.02, 62.01, depth)
    found, there = contents.series(place), contents.estimate.velocity_at(*place)
    assert (found["depth"] == depth).all()
    times = found["time"].to_numpy().astype(np.int64)
    assert times.tolist() == contents.slices.time_ns.tolist()
    # those of the small result are the same at all times
    np.testing.assert_allclose(found["u"], np.full(4, there.u), rtol=1e-6)
    np.testing.assert_allclose(found["v"], np.full(4, there.v), rtol=1e-6)
    for error in ("u_standard_error", "v_standard_error"):
        assert np.isfinite(found[error]).tolist() == [published] * 3 + [True]


def test_what_was_published_is_linear_between_cells_and_towards_true_north():
    projection = synthetic_flow().grid.projection
    east, north = np.array([0.0, 1e3, 2e3]), np.array([-1e3, 0.0])
    fields = np.arange(2 * 5 * 4 * 2 * 3, dtype=float).reshape(2, 5, 4, 2, 3)
    slices = CurrentSlices(np.array([10.0, 100.0]), np.arange(5), east, north, fields)

    def at(x, y, depth):
        place = (*(float(value) for value in to_geographic(projection, x, y)), depth)
        return place, *published_at(slices, projection, place)

    place, level, series = at(1_400.0, -600.0, 56.0)
    assert level == 100.0
    # which grow by one to the east and by three to the north
    cell = fields[1, :, :, 0, 0].T + 1.4 + 3.0 * 0.4
    true = rotate_to_geographic(projection, *place[:2], *cell[:2])
    np.testing.assert_allclose(series.T, [*true, *cell[2:]])
    for x, y, inside in ((2_490, 0, True), (2_510, 0, False), (0, 490, True), (0, 510, False)):
        assert np.isfinite(at(x, y, 10.0)[2]).all() == inside


def test_colours_of_a_section_are_common_to_velocities_and_to_differences():
    sizes = [np.full((2, 3), value) for value in (0.1, 0.3, np.nan, 0.02, 0.04, 0.005)]
    kinds = [kind for *_, kind in QUANTITIES]
    assert limits_of(kinds, np.stack(sizes)) == [0.3, 0.3, 0.3, 0.04, 0.04, 0.005]
