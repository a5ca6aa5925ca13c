"""Settings of earlier versions."""

import pytest

from replay_kit.config.file import with_current_keys
from replay_kit.config.run import load_config
from replay_kit.core.errors import ConfigError

OLD = '[time]\nscale = "auto"\n\n[trust]\ngate = "soften"\nwatch = false\nwatch_profiles = 7\n\n[planner]\nmost = "watch = 1"\n'


def test_the_old_table_is_refused_with_the_names_of_the_new_one(tmp_path):
    path = tmp_path / "run.toml"
    path.write_text("[trust]\nwatch = false\n")
    with pytest.raises(
        ConfigError,
        match=r"\[trust\] is now called \[gating\], .* watch is inflate, watch_profiles is inflation_profiles",
    ):
        load_config(path)


def test_a_recorded_configuration_keeps_its_values_under_the_current_names(tmp_path):
    new = with_current_keys(OLD)
    assert new == OLD.replace("[trust]", "[gating]").replace(
        "\nwatch_profiles =", "\ninflation_profiles ="
    ).replace("\nwatch =", "\ninflate =")
    path = tmp_path / "run.toml"
    path.write_text(new.split("[planner]")[0])
    gating = load_config(path).gating
    assert (gating.gate, gating.inflate, gating.inflation_profiles) == ("soften", False, 7)


def test_a_current_configuration_stays_as_it_is():
    assert with_current_keys("[gating]\ninflate = true\n") == "[gating]\ninflate = true\n"
    # a key that is no more goes where it changed nothing, and is refused where it did
    old = (
        "[measurements]\nuse_dac = true\n\n[planner]\nseed = 0\nflight_model = false\nspeed = 0.3\n"
    )
    assert with_current_keys(old) == "[measurements]\n\n[planner]\nseed = 0\nspeed = 0.3\n"
    assert "flight_model = true" in with_current_keys("[planner]\nflight_model = true\n")
    # the key of another table is not meant
    assert with_current_keys("[planner]\nuse_dac = true\n") == "[planner]\nuse_dac = true\n"


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
