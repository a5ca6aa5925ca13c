import re
from pathlib import Path

import pytest

import replay_kit.results
from replay_kit.core.observation import Reason
from replay_kit.results.schemas import CONTRACT_VERSION, MESSAGES

FOLDER = Path(replay_kit.results.__file__).parent
CHANNELS = (FOLDER / "CHANNELS.md").read_text(encoding="utf-8")


def documented(message: str) -> list[tuple[str, str]]:
    """Return (field, type) of a message's table in the README."""
    section = CHANNELS.split(f"### replay_kit.{message}\n")[1].split("\n#")[0]
    rows = re.findall(
        r"^\| (`\w+`(?:, `\w+`)*) \| ([\w.\[\]]+) \| .+ \| .+ \|$", section, flags=re.MULTILINE
    )
    return [(name, kind) for names, kind in rows for name in re.findall(r"\w+", names)]


@pytest.mark.parametrize("message", MESSAGES)
def test_the_contract_lists_every_field_in_order(message):
    fields = [
        (field.name, field.type.lstrip(".") + ("[]" if field.repeated else ""))
        for field in MESSAGES[message]
    ]
    assert documented(message) == fields


def test_the_contract_names_the_contract_version():
    assert f"Contract version {CONTRACT_VERSION}." in CHANNELS


def test_the_contract_lists_every_reason():
    listed = dict(re.findall(r"\b(\d+) \| ([a-z_]+) (?=\|)", CHANNELS))
    assert listed == {str(reason.value): str(reason.name).lower() for reason in Reason if reason}
