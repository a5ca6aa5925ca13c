"""Figures are those of the reference pictures: shrunk until letters are grey, so that another version of a font is no other picture.

A figure that differs is in the folder that the failure names: look at it, and copy it into ``references`` if it is right.
"""

import io
from dataclasses import replace
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest
from matplotlib.figure import Figure

from replay_kit.show.figures.draw import figure_bytes
from replay_kit.show.figures.kinds import drawn_figure
from tests.results.cases import write
from tests.synthetic_flow import synthetic_flow

REFERENCES = Path(__file__).parent / "references"
KINDS = ("map", "section", "trust")
#: Columns of a shrunk picture, and the largest root mean square difference of two that are alike, of 1 from black to white.
WIDTH, TOLERANCE = 80, 0.02


def shrunk(figure: Figure) -> np.ndarray:
    """Return the block means of a figure's colours in whole steps of 1/255, shape (rows, WIDTH, 3)."""
    pixels = matplotlib.image.imread(io.BytesIO(figure_bytes(figure, ".png")))[..., :3]
    block = pixels.shape[1] // WIDTH
    rows = pixels.shape[0] // block
    means = (
        pixels[: rows * block, : WIDTH * block]
        .reshape(rows, block, WIDTH, block, 3)
        .mean(axis=(1, 3))
    )
    return np.rint(255.0 * means) / 255.0


def difference(one: np.ndarray, other: np.ndarray) -> float:
    """Return the root mean square difference of two shrunk pictures; 1 where one is higher by more than two rows."""
    rows = min(len(one), len(other))
    if max(len(one), len(other)) > rows + 2:
        return 1.0
    return float(np.sqrt(np.mean((one[:rows] - other[:rows]) ** 2)))


@pytest.fixture
def pictures(tmp_path, innovation, plan):
    """Return a function that shrinks a figure of a small result, its innovations times a factor."""

    def shrink(kind: str, factor: float = 1.0) -> np.ndarray:
        growing = [
            replace(
                innovation,
                dive=k + 1,
                residual=factor * (k + 1) * innovation.residual,
                nis=6.0 * k + 1.0,
            )
            for k in range(5)
        ]
        return shrunk(
            drawn_figure(
                write(tmp_path / f"{factor:g}.mcap", synthetic_flow(), growing, plan), kind
            )
        )

    return shrink


@pytest.mark.parametrize("kind", KINDS)
def test_a_figure_is_the_reference_picture(pictures, kind, tmp_path):
    found = pictures(kind)
    matplotlib.image.imsave(tmp_path / f"{kind}.png", found)
    expected = matplotlib.image.imread(REFERENCES / f"{kind}.png")[..., :3]
    assert difference(found, expected) < TOLERANCE, f"look at {tmp_path / kind}.png"


@pytest.mark.full
def test_other_data_are_another_picture(pictures):
    section = pictures("section")
    assert difference(section, pictures("section", -1.0)) > 2.0 * TOLERANCE
    assert difference(section[:, ::-1], section) > 2.0 * TOLERANCE
    assert difference(section[:-3], section) == 1.0
    assert difference(section[:-2], section) == 0.0
    assert difference(section + 0.25, section) == pytest.approx(0.25)
