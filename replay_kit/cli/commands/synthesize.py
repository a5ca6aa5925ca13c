"""``synthesize``: a synthetic ocean."""

from pathlib import Path
from typing import Annotated

from replay_kit.cli.console import progress
from replay_kit.cli.options import NETCDF, OUTPUTS, TO_OUTPUTS, Replacing, option
from replay_kit.core.paths import check_paths


def synthesize(
    *,
    ensemble: Annotated[
        Path, option("--ensemble", "File of the members.", metavar="E.nc", group=OUTPUTS), NETCDF
    ],
    truth: Annotated[
        Path,
        option(
            "--truth", "File of one more member, the withheld truth.", metavar="T.nc", group=OUTPUTS
        ),
        NETCDF,
    ],
    members: Annotated[int, option("--members", "Number of members.", least=2)] = 40,
    seed: Annotated[int, option("--seed", "The same seed gives the same bytes.")] = 0,
    replacing: Annotated[Replacing, TO_OUTPUTS] = Replacing(),
) -> int:
    """Return 0."""
    check_paths([], [ensemble, truth], replacing.overwrite)

    from replay_kit.studies.twins import write_ensemble

    with progress() as advance:
        advance(0, 0, "making the ensemble")
        write_ensemble(ensemble, truth, n_members=members, seed=seed, overwrite=replacing.overwrite)
    return 0
