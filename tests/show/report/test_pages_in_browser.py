"""Pages of odd results are drawn in a browser without an error, and first screens are those of the reference pictures.

A screen that differs is where the failure says: look at it, and copy it into ``references`` if it is right.
"""

import io
from base64 import b64encode
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import matplotlib.image
import numpy as np
import pytest

from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.grid import Projection
from replay_kit.core.plan import Area
from replay_kit.results import ResultWriter
from replay_kit.show.notebook import read_result
from replay_kit.show.report.pages import report_html
from tests.browser import MARKS, SCHEMES, check_drawn, chromium, opened, unfold
from tests.results.cases import placed
from tests.results.conftest import innovation, plan, state  # noqa: F401 - fixtures
from tests.results.result_samples import CONFIG, METADATA
from tests.show.report.replays import sample
from tests.synthetic_flow import TIME_NS

# fixtures of other modules are imported by their names
# ruff: noqa: F811

pytestmark = MARKS
REFERENCES = Path(__file__).parent / "references"
#: Width and height of first screens.
SCREENS = {"wide": (1280, 900), "phone": (390, 844)}
#: Blocks of pixels that are averaged, and the largest root mean square difference of two that are alike, of 1 from black to white.
BLOCK, TOLERANCE = 10, 0.04
MARKUP = "<img src=x onerror=alert(1)><script>alert(2)</script>&amp;"


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium() as own:
        yield own


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
    page = report_html(read_result(path))
    for width in (1280, 390):
        with opened(browser, page, width) as tab:
            unfold(tab)
            assert check_drawn(tab, width) >= 1
            tab.locator("#current-map .plot").hover()
            assert "°" in tab.locator("#current-map .tip").inner_text()


def blocks(picture: bytes) -> np.ndarray:
    """Return the block means of a picture, shape (rows, columns, 3): letters become grey."""
    pixels = matplotlib.image.imread(io.BytesIO(picture))[..., :3]
    rows, columns = pixels.shape[0] // BLOCK, pixels.shape[1] // BLOCK
    whole = pixels[: rows * BLOCK, : columns * BLOCK]
    return whole.reshape(rows, BLOCK, columns, BLOCK, 3).mean(axis=(1, 3))


def first_screens(browser: Any, page: str) -> Iterator[tuple[str, bytes]]:
    """Yield the first screen of a page at each size in both schemes, by its name, in letters that matplotlib brings along."""
    font = Path(matplotlib.get_data_path(), "fonts", "ttf", "DejaVuSans.ttf").read_bytes()
    face = f"@font-face {{ font-family: Own; src: url(data:font/ttf;base64,{b64encode(font).decode()}) }}"
    styled = page.replace("</style>", f"{face}\n* {{ font-family: Own !important }}</style>", 1)
    # only the test's own font is asked for
    allowed = styled.replace("default-src 'none';", "default-src 'none'; font-src data:;", 1)
    for (size, (width, height)), scheme in product(SCREENS.items(), SCHEMES):
        with opened(browser, allowed, width, scheme) as tab:
            tab.set_viewport_size({"width": width, "height": height})
            tab.evaluate("() => document.fonts.ready")
            tab.wait_for_timeout(600)
            yield f"{size}-{scheme}", tab.screenshot(timeout=120_000)


@pytest.mark.skipif(
    not REFERENCES.is_dir(), reason="the reference pictures are not in the source archive"
)
def test_first_screens_are_the_reference_pictures(browser, tmp_path):
    page = report_html(read_result(sample(tmp_path)))
    for screen, picture in first_screens(browser, page):
        found, path = blocks(picture), tmp_path / f"sample-{screen}.png"
        matplotlib.image.imsave(path, found)
        expected = matplotlib.image.imread(REFERENCES / path.name)[..., :3]
        assert found.shape == expected.shape
        difference = float(np.sqrt(np.mean((found - expected) ** 2)))
        assert difference < TOLERANCE, f"look at {path}"
        # a screen upside down is refused
        assert float(np.sqrt(np.mean((found[::-1] - expected) ** 2))) > TOLERANCE


def test_reference_pictures_are_few_and_small():
    files = sorted(REFERENCES.iterdir())
    names = [f"sample-{size}-{scheme}" for size, scheme in product(SCREENS, SCHEMES)]
    assert [path.stem for path in files] == sorted(names)
    assert sum(path.stat().st_size for path in files) < 3e5
