"""``config``: the settings that a file of ``--config`` may hold."""

import sys
from typing import Annotated

from cyclopts import Parameter

from replay_kit.cli.options import INPUTS
from replay_kit.config.listing import annotated_toml


def config(
    *sections: Annotated[
        str, Parameter(name="SECTION", help="Tables such as planner. Default: all.", group=INPUTS)
    ],
) -> int:
    """Return 0."""
    sys.stdout.write(annotated_toml(sections))
    return 0
