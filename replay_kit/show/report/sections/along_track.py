"""Report section on the track: profiles and DACs, measured, estimated, their difference and standard error."""

from replay_kit.results.views.contents import Contents
from replay_kit.show.figures.section import dives_figure, section_figure
from replay_kit.show.page.page import Section


def along_track_section(contents: Contents) -> Section:
    """Return the report section on profiles along the track and DACs."""
    each = section_figure(contents), dives_figure(contents)
    figures = [figure for figure in each if figure.panels[0].marks]
    missing = [figure.panels[0].note for figure in each if figure not in figures]
    title = "How does it change along the track, with depth and time?"
    profiles, dives = contents.bins.profiles, contents.mean_currents.time_ns.size
    answer = f"{profiles:,} profiles and {dives:,} DACs, compared with the estimate."
    return Section("section", title, "", figures, missing, "Section", answer)
