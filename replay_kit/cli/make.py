"""The commands that make what a replay needs: fitted settings, twins, a synthetic ocean."""

from pathlib import Path
from typing import Annotated, Literal

import typer
from threadpoolctl import threadpool_limits

from replay_kit.cli.options import (
    JsonOption,
    LeadOption,
    LevelsOption,
    LevelStepOption,
    ModesOption,
    NoiseOption,
    OverwriteOption,
    RegionOption,
    bar,
    console_beside,
    ends_in,
    forecast_part,
    write_json,
)
from replay_kit.config.run import load_config
from replay_kit.forecast import read_changing_truth, read_ensemble, read_truth
from replay_kit.studies.twins import EPOCH, Faults, Options, make_twin, write_ensemble
from replay_kit.workflows.fit import fit_json, fit_prior, print_fit, write_fit
from replay_kit.workflows.paths import check_paths, truth_path


def fit(
    ensemble: Annotated[Path, typer.Argument(metavar="ENSEMBLE", help="Ensemble forecast.")],
    out: Annotated[Path, typer.Option("--out", "-o", metavar="TOML", callback=ends_in(".toml"), help="Settings for --config.")],
    left_out: Annotated[int, typer.Option("--left-out", min=1, help="Members left out in turn.")] = 12,
    lead: LeadOption = None,
    region: RegionOption = None,
    levels: LevelsOption = None,
    level_step: LevelStepOption = None,
    modes: ModesOption = None,
    json_file: JsonOption = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Fit the prior to an ensemble by leaving members out, and say what was chosen."""
    check_paths([ensemble], [out, json_file], overwrite)
    settings = load_config(None, {"forecast": forecast_part(region, levels, level_step, lead), "estimator": {"modes": modes}})
    members = read_ensemble(ensemble, settings.forecast)
    with threadpool_limits(limits=settings.output.threads), bar() as advance:
        fitted = fit_prior(members, settings.estimator, left_out, advance)
    write_fit(fitted, out)
    print_fit(fitted, console_beside(json_file))
    write_json(json_file, fit_json(fitted))


def twin(
    truth: Annotated[str, typer.Option("--truth", metavar="FILE[#member]", help="The truth the vehicle moves in.")],
    out: Annotated[
        Path,
        typer.Option(
            "--out", "-o", metavar="X.mcap|X.tlog", callback=ends_in(".mcap", ".tlog"), help="The log; its ending chooses the format."
        ),
    ],
    vehicle: Annotated[
        Literal["vessel", "glider"], typer.Option("--vehicle", help="Survey at random positions, or a sawtooth glider.")
    ] = "vessel",
    pings: Annotated[int, typer.Option("--pings", min=1, help="ADCP pings.")] = 450,
    noise: NoiseOption = 0.09,
    seed: Annotated[int, typer.Option("--seed", help="The same seed gives the same bytes.")] = 0,
    interval: Annotated[float, typer.Option("--interval", metavar="S", help="From ping to ping of a glider; 120 s or a multiple.")] = 600.0,
    changing: Annotated[bool, typer.Option("--changing", help="The sea changes through all leads or times of the truth.")] = False,
    reference: Annotated[Literal["earth", "platform"], typer.Option("--reference", help="What the velocities are relative to.")] = "earth",
    platform_std: Annotated[
        float | None, typer.Option("--platform-std", metavar="S", help="Pings state the platform's velocity, with this error [m/s].")
    ] = None,
    heading_bias: Annotated[float, typer.Option("--heading-bias", metavar="DEG", help="Of the compass, clockwise.")] = 0.0,
    scale_error: Annotated[float, typer.Option("--scale-error", metavar="SHARE", help="Of what is measured; 0.03 is 3 % too much.")] = 0.0,
    outliers: Annotated[float, typer.Option("--outliers", metavar="SHARE", help="Pings that are 1 m/s off.")] = 0.0,
    dac_only: Annotated[bool, typer.Option("--dac-only", help="A glider's positions and mean currents, no pings.")] = False,
    region: RegionOption = None,
    levels: LevelsOption = None,
    level_step: LevelStepOption = None,
    lead: LeadOption = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Make a log by flying a vehicle with a simulated ADCP through a truth."""
    check_paths([truth_path(truth)], [out], overwrite)
    settings = load_config(None, {"forecast": forecast_part(region, levels, level_step, lead)}).forecast
    options = Options(Faults(reference, platform_std, heading_bias, scale_error, outliers), interval, dac_only)
    sea = read_changing_truth(truth, settings, EPOCH) if changing else read_truth(truth, settings)
    made = make_twin(sea, vehicle, pings, noise, seed, out, overwrite, options)
    said = f"{made.pings} pings" if made.pings else f"{made.dives} mean currents"
    console_beside(None).print(f"{out}: {said} over {made.duration / 3600.0:.1f} h", soft_wrap=True)


def synthesize(
    ensemble: Annotated[Path, typer.Option("--ensemble", metavar="E.nc", callback=ends_in(".nc"), help="Where the members go.")],
    truth: Annotated[Path, typer.Option("--truth", metavar="T.nc", callback=ends_in(".nc"), help="Where one more, withheld, goes.")],
    members: Annotated[int, typer.Option("--members", min=2, help="Members.")] = 40,
    seed: Annotated[int, typer.Option("--seed", help="The same seed gives the same bytes.")] = 0,
    overwrite: OverwriteOption = False,
) -> None:
    """Make a synthetic ensemble (incompressible, eddying, baroclinic) and a truth withheld from it."""
    check_paths([], [ensemble, truth], overwrite)
    write_ensemble(ensemble, truth, n_members=members, seed=seed, overwrite=overwrite)
