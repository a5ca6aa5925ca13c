"""Studies and fits whose calls workers make: the figures of one process, and progress that reaches its end."""

from replay_kit.config.run import EstimatorConfig
from replay_kit.core.words.progress import called_by
from replay_kit.workflows.ensemble import fit_prior
from tests import synthetic
from tests.command import invoke

MEMBERS = synthetic.ensemble(n_members=6, shape=(8, 9))
MODES = EstimatorConfig(modes=6, sample_share=0.6)


def test_fit(cluster):
    here = fit_prior(MEMBERS, MODES, 3)
    with called_by(cluster.starmap):
        assert fit_prior(MEMBERS, MODES, 3) == here


def test_the_switch_is_on_every_command_of_the_studies():
    for command in ("experiment paper", "fit"):
        words = invoke([*command.split(), "--help"]).stdout.split()
        assert {"--scheduler", "--workers"} <= set(words)
