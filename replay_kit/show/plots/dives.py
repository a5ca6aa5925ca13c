"""Mean currents of dives beside the estimate's."""

from dataclasses import replace

import numpy as np

from replay_kit.results.views.contents import Contents
from replay_kit.show.figures.along_track import comparison_chart, mean_current_chart
from replay_kit.show.figures.in_print import drawing_of
from replay_kit.show.plots.current_map import At
from replay_kit.show.plots.panel import Panel, Panels, missing


def dive_panels(contents: Contents, at: At | None) -> Panels:
    """Return the depth-averaged currents of the dives, measured, corrected and estimated, through time and against each other.

    Args:
        contents: Of the result.
        at: Not used: the currents are those of the dives.
    """
    means, notes = contents.mean_currents, list(contents.notes)
    if means.time_ns.size == 0:
        why = "The result holds no mean current of a dive: its vehicle does not dive, or the log has none that was used."
        return Panels([missing("Depth-averaged currents of dives", why)], 1, notes)
    chart, known = mean_current_chart(means), bool(np.isfinite(means.estimated).any())
    panels = [
        Panel(panel.title, drawing_of(chart, k, 4), 0.85 if known else 0.55)
        for k, panel in enumerate(chart.panels)
    ]
    if known:
        scatter = Panel("all dives", drawing_of(comparison_chart(means), 0), 0.85)
        return Panels([*panels, scatter], 3, notes)
    notes.append(
        "The result holds no estimate: the figure shows measured minus estimated currents."
    )
    return Panels([replace(panel, height=0.55) for panel in panels], 2, notes)
