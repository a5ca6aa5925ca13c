"""Pages of odd results are drawn in a browser without an error, and the first screen is that of the reference pictures."""

import io
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib.image
import numpy as np
import pytest

import replay_kit as rk
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.geodesy import to_geographic
from replay_kit.core.grid import Projection
from replay_kit.core.plan import Area
from replay_kit.results import ResultWriter
from replay_kit.show import open_result
from replay_kit.show.report import report_html
from tests.browser import MARKS, check_drawn, chromium, opened, unfold
from tests.places import SAMPLES
from tests.results.conftest import plan, state  # noqa: F401 - fixtures
from tests.results.result_samples import CONFIG, METADATA
from tests.synthetic_flow import TIME_NS, synthetic_flow

# fixtures of other modules are imported by their names
# ruff: noqa: F811

pytestmark = MARKS
REFERENCES = Path(__file__).parent / "references"
#: Width, height and colours of each picture of the sample's first screen.
SCREENS = {"light": (1440, 900), "dark": (1280, 800), "phone": (390, 844)}
#: Blocks of pixels that are averaged, and the largest root mean square difference of two that are alike, of 1 from black to white.
BLOCK, TOLERANCE = 10, 0.04
MARKUP = "<img src=x onerror=alert(1)><script>alert(2)</script>&amp;"


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium() as own:
        yield own


def placed(longitude: float, latitude: float) -> FlowEstimate:
    flow = synthetic_flow(latitude=latitude)
    projection = Projection(longitude, latitude)
    places = to_geographic(projection, flow.grid.east, flow.grid.north)
    moved = replace(flow.grid, projection=projection, longitude=places[0], latitude=places[1])
    return replace(flow, grid=moved)


def _dry(flow: FlowEstimate) -> FlowEstimate:
    flow.grid.wet[1] = False
    return flow


ODD: dict[str, Callable[[], FlowEstimate | None]] = {
    "one fix alone": lambda: None,
    "one fix": lambda: placed(5.0, 62.0),
    "no position": lambda: placed(5.0, 62.0),
    "antimeridian": lambda: placed(180.0, 66.0),
    "80 N": lambda: placed(20.0, 80.0),
    "a dry depth": lambda: _dry(placed(5.0, 62.0)),
    "long name": lambda: placed(5.0, 62.0),
    "markup": lambda: placed(5.0, 62.0),
}


@pytest.mark.parametrize("name", ODD)
def test_odd_results_are_drawn(browser, tmp_path, state, plan, name):
    flow = ODD[name]()
    projection = Projection(5.0, 62.0) if flow is None else flow.grid.projection
    text = {"long name": "n" * 300, "markup": MARKUP}.get(name, "shoal")
    centre = projection.longitude, projection.latitude
    corners = tuple((centre[0] + x, centre[1] + y) for x, y in ((0.0, 0.0), (0.1, 0.0), (0.1, 0.1)))
    path = tmp_path / ("r" * 200 + ".mcap" if name == "long name" else "r.mcap")
    with ResultWriter(path) as writer:
        writer.start(projection, TIME_NS, METADATA, CONFIG)
        if name != "no position":
            writer.fix(replace(state, longitude=centre[0], latitude=centre[1]))
        if name in ("long name", "markup"):
            named = replace(plan, areas=(Area(text, False, corners),), message=text)
            writer.plan(named, projection)
        if flow is not None:
            writer.finish(flow)
    page = report_html(open_result(path))
    for width in (1280, 390):
        with opened(browser, page, width) as tab:
            unfold(tab)
            assert check_drawn(tab, width) >= 1
            tab.locator("#current-map .plot").hover()
            assert "°" in tab.locator(".tip").inner_text()


def blocks(picture: bytes) -> np.ndarray:
    """Return the block means of a picture, shape (rows, columns, 3): letters become grey."""
    pixels = matplotlib.image.imread(io.BytesIO(picture))[..., :3]
    rows, columns = pixels.shape[0] // BLOCK, pixels.shape[1] // BLOCK
    whole = pixels[: rows * BLOCK, : columns * BLOCK]
    return whole.reshape(rows, BLOCK, columns, BLOCK, 3).mean(axis=(1, 3))


@pytest.mark.skipif(
    not REFERENCES.is_dir(), reason="the reference pictures are not in the source archive"
)
def test_the_first_screen_is_that_of_the_reference_pictures(browser, tmp_path):
    out, settings = tmp_path / "sample.mcap", {"estimator": {"modes": 40}}
    logs = SAMPLES / "glider.mcap", SAMPLES / "ensemble.nc"
    page = report_html(rk.replay(*logs, goal=(152.8, -40.1, 300.0), settings=settings, out=out))
    for name, (width, height) in SCREENS.items():
        with opened(browser, page, width, "dark" if name == "dark" else "light") as tab:
            tab.set_viewport_size({"width": width, "height": height})
            tab.wait_for_timeout(600)
            found = blocks(tab.screenshot())
        matplotlib.image.imsave(tmp_path / f"{name}.png", found)
        expected = matplotlib.image.imread(REFERENCES / f"{name}.png")[..., :3]
        assert found.shape == expected.shape
        difference = float(np.sqrt(np.mean((found - expected) ** 2)))
        assert difference < TOLERANCE, f"look at {tmp_path / name}.png"
        # a screen upside down is another
        assert float(np.sqrt(np.mean((found[::-1] - expected) ** 2))) > 2.0 * TOLERANCE
