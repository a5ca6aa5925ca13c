"""``plot``: a figure of a result for a paper."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from replay_kit.cli.console import console_beside
from replay_kit.cli.options import (
    OUTPUTS,
    TO_OPTIONS,
    TO_OUTPUTS,
    Ending,
    Replacing,
    argument,
    option,
)
from replay_kit.config.option import PLACE, numbers
from replay_kit.core.paths import check_paths

_ENDINGS = Ending((".png", ".svg", ".pdf"))


@dataclass(frozen=True, slots=True, kw_only=True)
class Look:
    """What a figure shows, and how wide it is."""

    at: Annotated[
        str | None,
        option(
            "--at",
            "Place of series; depth of map and plan [degrees, degrees, m].",
            metavar="LON,LAT,DEPTH",
        ),
        PLACE,
    ] = None
    columns: Annotated[
        Literal[1, 2],
        option("--columns", "Width in journal columns: 85 or 175 mm."),
    ] = 2


def plot(
    result: Annotated[
        Path,
        argument(
            "RESULT.mcap",
            "A result of replay or plan; of a truncated one the readable part is shown.",
        ),
    ],
    figure: Annotated[
        Literal["map", "section", "series", "dac", "trust", "plan"],
        argument("FIGURE", "Kind of figure."),
    ],
    /,
    *,
    out: Annotated[
        Path,
        option(
            "--out -o",
            "Figure; its ending selects the format.",
            metavar="F.png|svg|pdf",
            group=OUTPUTS,
        ),
        _ENDINGS,
    ],
    look: Annotated[Look, TO_OPTIONS] = Look(),
    replacing: Annotated[Replacing, TO_OUTPUTS] = Replacing(),
) -> int:
    """Return 0, or 4 when part of the result was lost."""
    check_paths([result], [out], replacing.overwrite)
    longitude, latitude, depth = numbers(look.at or "0,0,0", "--at", PLACE.form)
    at = None if look.at is None else (longitude, latitude, depth)

    from replay_kit.core.atomic import atomic_file
    from replay_kit.show.plots import drawn
    from replay_kit.show.plots.style import saved
    from replay_kit.show.text import print_lines
    from replay_kit.workflows.report import opened

    with opened(result) as contents:
        content = saved(drawn(contents, figure, at, look.columns), out.suffix.lower())
    with atomic_file(out) as file:
        file.write(content)
    print_lines(console := console_beside(None), contents.notes)
    console.print(f"Figure: {out}", soft_wrap=True)
    return contents.exit_code
