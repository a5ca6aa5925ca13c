"""``layout``: how Foxglove or Lichtblick shows a result."""

from pathlib import Path
from typing import Annotated

from replay_kit.cli.console import console_beside
from replay_kit.cli.options import OUTPUTS, TO_OUTPUTS, Ending, Replacing, argument, option
from replay_kit.core.paths import check_paths


def layout(
    result: Annotated[Path, argument("RESULT.mcap", "A result of replay.")],
    /,
    *,
    out: Annotated[
        Path,
        option(
            "--out -o",
            "Layout file to import into the viewer.",
            metavar="LAYOUT.json",
            group=OUTPUTS,
        ),
        Ending((".json",)),
    ],
    replacing: Annotated[Replacing, TO_OUTPUTS] = Replacing(),
) -> int:
    """Return 0."""
    check_paths([result], [out], replacing.overwrite)

    from replay_kit.workflows.layout import write_layout

    count = write_layout(result, out)
    console_beside().print(
        f"{out}: {count} panels; import it in Foxglove or Lichtblick, and open {result} there.",
        soft_wrap=True,
    )
    return 0
