"""Settings of earlier versions."""

import pytest

from replay_kit.config.run import load_config
from replay_kit.core.errors import ConfigError
from tests.command import invoke


def test_the_old_table_is_refused_with_the_names_of_the_new_one(tmp_path):
    path = tmp_path / "run.toml"
    path.write_text("[trust]\nwatch = false\n")
    with pytest.raises(
        ConfigError,
        match=r"\[trust\] is now called \[gating\]; rename it, and leave out",
    ):
        load_config(path)


@pytest.mark.parametrize(
    ("toml", "instead"),
    [
        (
            "[measurements]\nuse_dac = false\n",
            r"\[measurements\] has no use_dac any more: without = \[\"dac\"\]",
        ),
        (
            "[forecast]\nlevel_step = 2\n",
            r"\[forecast\] has no level_step any more: name the levels",
        ),
        (
            "[[measurements.map]]\njoin_within = 0.1\n",
            r"\[measurements\.map\] has no join_within any more: record both",
        ),
        ("[gating]\ngate = 'soften'\n", "gating.gate has no soften any more: what exceeds"),
        ("[gating]\ninflate = true\n", r"\[gating\] has no inflate any more: an ensemble"),
        ("[time]\ndropped_std = 0.01\n", r"\[time\] has no dropped_std any more: it is \["),
        ("[time]\noscillators = ['steady']\n", "--oscillators has no steady any more: closer"),
        ("[plan]\nbox = '1,2,3,4'\n", r"\[plan\] has no box any more: without adaptive"),
    ],
)
def test_a_removed_key_is_refused_with_what_to_write_instead(tmp_path, toml, instead):
    path = tmp_path / "run.toml"
    path.write_text(toml)
    with pytest.raises(ConfigError, match=instead):
        load_config(path)


@pytest.mark.parametrize(
    ("line", "instead"),
    [
        ("plan flow.nc --policy a.csv", "It was removed: it assumed"),
        ("plan flow.nc --profile-error 1", "It was removed: without"),
        ("fleet fleet.toml -o out --dry-run", "It was removed: replay --dry-run"),
        (
            "plan flow.nc --start=1,2,0 --goal=1,2,0 --objective map",
            "--objective has no map any more: without adaptive",
        ),
    ],
)
def test_a_removed_option_is_refused_with_what_to_use_instead(line, instead):
    done = invoke(line)
    assert done.exit_code == 2
    assert instead in done.output.replace("\n", " ")
