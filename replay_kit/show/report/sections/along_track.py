"""Report section on the track: profiles and DACs, measured, estimated, their difference and standard error."""

import numpy as np

from replay_kit.results.views.contents import Contents
from replay_kit.show.figures.section import dives_figure, section_figure
from replay_kit.show.page.page import Section


def along_track_section(contents: Contents) -> Section:
    """Return the report section on profiles along the track and DACs."""
    bins, missing, figures = contents.section, [], []
    if bins.time_ns.size:
        figures.append(section_figure(contents))
    if not contents.bins.time_ns.size:
        without = (
            "the section shows only the estimate along the track"
            if bins.time_ns.size
            else "there is no section"
        )
        missing.append(f"The result holds no profile of the current that was used: {without}.")
    if bins.time_ns.size and not np.isfinite(bins.estimated).any():
        missing.append(
            "Without an estimate, the section shows the difference only, which the result holds for each bin."
        )
    dives, profiles = contents.mean_currents.time_ns.size, contents.bins.profiles
    if dives:
        figures.append(dives_figure(contents))
    else:
        missing.append("The result holds no DAC (depth-averaged current) that was used.")
    title = "How does it change along the track, with depth and time?"
    answer = f"{profiles:,} profiles and {dives:,} DACs, compared with the estimate."
    return Section("section", title, "", figures, missing, "Section", answer)
