import re
from pathlib import Path

import pytest

import replay_kit.results
from replay_kit.core.observation import Reason
from replay_kit.results.mcap.schemas import CONTRACT_VERSION, MESSAGES

FOLDER = Path(replay_kit.results.__file__).parent
CHANNELS = (FOLDER / "CHANNELS.md").read_text(encoding="utf-8")


def documented(message: str) -> list[str]:
    """Return the fields of a message's table in the contract."""
    section = CHANNELS.split(f"### replay_kit.{message}\n")[1].split("\n#")[0]
    rows = re.findall(r"^\| (`\w+`(?:, `\w+`)*) \| .+ \|$", section, flags=re.MULTILINE)
    return re.findall(r"\w+", " ".join(rows))


@pytest.mark.parametrize("message", MESSAGES)
def test_the_contract_lists_every_field_in_order(message):
    assert documented(message) == [field.name for field in MESSAGES[message]]


def test_the_contract_names_the_contract_version():
    assert f"Contract version {CONTRACT_VERSION}." in CHANNELS


def test_the_contract_lists_every_reason():
    listed = dict(re.findall(r"\b(\d+)\s`([a-z_]+)`", CHANNELS))
    assert listed == {str(reason.value): str(reason.name).lower() for reason in Reason if reason}
