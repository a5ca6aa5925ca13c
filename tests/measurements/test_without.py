"""Measurements that are left out: which, that their messages count as not used, and what is refused."""

import pytest

from replay_kit.config.quality import rules_for
from replay_kit.config.run import MeasurementConfig
from replay_kit.measurements.step import left_out_reason, left_out_rules


@pytest.mark.parametrize(
    ("rules", "kind", "dive", "applied"),
    [
        (("dac",), "radar", 3, ()),
        (("dives:3-5",), "profiles", 3, ("dives:3-5",)),
        (("dives:4", "dac"), "dac", 4, ("dives:4", "dac")),
        (("dives:1-9",), "dac", 0, ()),
    ],
)
def test_which_rules_leave_a_measurement_out(rules, kind, dive, applied):
    assert rules_for(rules, kind, dive) == applied


def test_the_reason_of_what_is_left_out_names_its_rules():
    assert left_out_rules(left_out_reason(("dac", "dives:3"))) == ["dac", "dives:3"]
    assert left_out_rules("faster than measurements.max_speed") == []


@pytest.mark.parametrize(
    "rule", ["current", "dives:", "dives:5-3", "dives:0", "dives:1-2-3", "DAC"]
)
def test_a_rule_that_is_none_is_refused(rule):
    with pytest.raises(
        ValueError, match="expected dac, profiles, shear, radar, drifters, sensors or dives:3-5"
    ):
        MeasurementConfig(without=(rule,))
    with pytest.raises(ValueError, match="each once"):
        MeasurementConfig(without=("dac", "dac"))
