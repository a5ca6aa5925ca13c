"""Whether the stated errors hold: innovations by dive and through time, their distribution, the decrease of the error."""

from replay_kit.results.views.contents import Contents
from replay_kit.show.figures.in_print import drawing_of
from replay_kit.show.figures.trust import trust_charts
from replay_kit.show.plots.current_map import At
from replay_kit.show.plots.panel import Panel, Panels, missing

# Panel of each chart that a paper needs.
_SHOWN = {"dives": 0, "innovations": 1, "calibration": 0, "error": 0}


def trust_panels(contents: Contents, at: At | None) -> Panels:
    """Return what tells whether the estimate's stated errors hold.

    Args:
        contents: Of the result.
        at: Not used: all measurements count.
    """
    notes = list(contents.notes)
    if not len(contents.result.observations):
        why = "The result holds no measurement to compare the estimate with."
        return Panels([missing("Innovations", why)], 1, notes)
    charts, lacking = trust_charts(contents)
    shown = [(charts[key], number) for key, number in _SHOWN.items() if key in charts]
    panels = [
        Panel(chart.panels[number].title, drawing_of(chart, number), 0.6) for chart, number in shown
    ]
    return Panels(panels, 2, [*notes, *lacking])
