"""Settings of earlier versions."""

import pytest

from replay_kit.config.run import load_config
from replay_kit.core.errors import ConfigError


def test_the_old_table_is_refused_with_the_names_of_the_new_one(tmp_path):
    path = tmp_path / "run.toml"
    path.write_text("[trust]\nwatch = false\n")
    with pytest.raises(
        ConfigError,
        match=r"\[trust\] is now called \[gating\], .* watch is inflate, watch_profiles is inflation_profiles",
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
    ],
)
def test_a_removed_key_is_refused_with_what_to_write_instead(tmp_path, toml, instead):
    path = tmp_path / "run.toml"
    path.write_text(toml)
    with pytest.raises(ConfigError, match=instead):
        load_config(path)
