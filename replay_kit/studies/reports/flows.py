"""Names and styles of the flows that studies estimate or plan on, the same in every table and figure."""

from dataclasses import dataclass

# Okabe and Ito's colours, which colour-blind readers can tell apart too.
BLACK, GREY, ORANGE, SKY = "#000000", "#8C8C8C", "#E69F00", "#56B4E9"
GREEN, BLUE, VERMILION, PURPLE = "#009E73", "#0072B2", "#D55E00", "#CC79A7"
EAST, NORTH, DEPTH = "east [km]", "north [km]", "depth [m]"
TRUTH, AVERAGED = "truth", "depth_averaged_truth"


@dataclass(frozen=True, slots=True)
class FlowStyle:
    """How a flow is named and drawn.

    Attributes:
        label: In tables and legends.
        colour: Of lines and markers.
        marker: Of points.
        line: Style of lines.
        width: Of lines.
    """

    label: str
    colour: str
    marker: str
    line: str = "-"
    width: float = 1.8


FLOW_STYLES = {
    TRUTH: FlowStyle("truth", BLACK, "x", width=3.2),
    AVERAGED: FlowStyle("depth-averaged truth", GREY, "P", width=2.2),
    "naive3d": FlowStyle("naive 3D basis", ORANGE, "^"),
    "paper": FlowStyle("2.5D paper, l = 10 km", VERMILION, "s", "--"),
    "paper_cells": FlowStyle("2.5D paper, l = 1.16 cells", PURPLE, "D", "--"),
    "default": FlowStyle("2.5D default", BLUE, "o"),
    "nearest": FlowStyle("nearest member", GREEN, "v", "-."),
    "ensemble_mean": FlowStyle("ensemble mean", SKY, "*", "-."),
}
LABELS = {name: style.label for name, style in FLOW_STYLES.items()}
