"""Both backends draw the same marks: on the page and in print a chart has the same entries, values and units."""

import numpy as np
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

from replay_kit.core.colors import PRINT
from replay_kit.show.figures.in_print import drawing_of
from replay_kit.show.figures.on_page import figure_of
from replay_kit.show.figures.values import Axis, Chart, Mark, Panel

TABLE = {
    "time": np.array(["2023-11-14T22:00:00", "2023-11-14T23:00:00"], "datetime64[ns]"),
    "u": np.array([0.25, np.nan]),
    "std": np.array([0.5, 0.125]),
}
MARKS = [
    Mark("joined", "t.time", "t.u", "estimate", "one", dash="dash", symbol="square"),
    Mark("points", "t.time", "t.std", "measured", "two", error="t.std"),
    Mark("line", "t.time", "t.std", "hidden", shown=False),
]
CHART = Chart(
    "key",
    "Title",
    Axis("time (UTC)"),
    [Panel("a", Axis("speed", "m/s", from_zero=True), MARKS, level=0.1, band=(0.0, 0.2, "95 %"))],
    tables={"t": TABLE},
)


def test_the_page_and_print_show_the_same():
    page, axes = figure_of(CHART), Figure().add_subplot()
    drawing_of(CHART, 0)(axes)
    assert page.tables["t"] == {
        "time": ["2023-11-14 22:00:00", "2023-11-14 23:00:00"],
        "u": [0.25, None],
        "std": [0.5, 0.125],
    }
    estimate, measured, hidden = page.traces
    assert (estimate["x"], estimate["y"], measured["error_y"]["array"]) == (
        "$t.time",
        "$t.u",
        "$t.std",
    )
    assert hidden["visible"] == "legendonly"
    assert set(axes.get_legend_handles_labels()[1]) == {"estimate", "measured", "95 %"}
    (line,) = (line for line in axes.lines if line.get_label() == "estimate")
    np.testing.assert_array_equal(line.get_ydata(), TABLE["u"])
    assert (line.get_linestyle(), line.get_marker()) == ("--", "s")
    assert (estimate["line"]["dash"], estimate["marker"]["symbol"]) == ("dash", "square")
    assert estimate["line"]["color"] == {"$color": "one"}
    assert to_hex(line.get_color()) == PRINT["one"].lower()
    assert page.layout["yaxis"]["title"]["text"] == "speed [m/s]"
    assert axes.get_ylabel() == "speed [m s$^{-1}$]"
    assert (page.layout["yaxis"]["rangemode"], axes.get_ylim()[0]) == ("tozero", 0.0)
    assert [shape["y0"] for shape in page.layout["shapes"]] == [0.0, 0.1]
