"""How to reproduce the result: versions, inputs with their hashes, settings, command; and every number of the summary."""

import json
import shlex
from collections.abc import Mapping
from html import escape
from typing import Any

from replay_kit.results.views.contents import Contents
from replay_kit.results.views.record import changed_settings, leaves
from replay_kit.show.numbers import number
from replay_kit.show.page.section import Section, table_html

# Entries of a list of the summary that are shown.
_LONG = 40


def again_section(contents: Contents) -> Section:
    """Return what it takes to reproduce the result, and the summary as a table."""
    record, missing = contents.record, []
    inputs = record.metadata.get("replay_kit.inputs", {})
    html = ""
    if any(name.startswith("log") for name in inputs):
        html += (
            f"<p>The command; <code>config.toml</code> is attached "
            f"to the result:</p><pre>{escape(_command(contents))}</pre>"
        )
    elif inputs:
        made = "; replay-kit verify reproduces it" if "replay_kit.plan" in record.metadata else ""
        missing.append(f"This result was made by replay-kit plan; its options are below{made}.")
    else:
        missing.append("The result does not name its inputs.")
    if inputs:
        html += table_html(
            ["input", "file", "SHA-256"],
            [_input(name, text) for name, text in inputs.items()],
            "Inputs",
        )
    versions = {
        **record.metadata.get("contract", {}),
        **record.metadata.get("replay_kit.versions", {}),
    }
    names = {"version": "contract of the result", "replay_kit": "replay-kit"}
    shown = {names.get(name, name): value for name, value in versions.items()}
    html += table_html(
        ["what", "version"],
        [[escape(name), escape(value)] for name, value in shown.items()],
        "Versions",
    )
    html += _settings(contents, missing)
    region = {
        **record.metadata.get("replay_kit.region", {}),
        **record.metadata.get("replay_kit.options", {}),
    }
    rows = [
        [escape(name.replace("_", " ")), escape(value)] for name, value in region.items() if value
    ]
    html += table_html(["what", "value"], rows, "Region, basis and options") if rows else ""
    html += _numbers(contents)
    title, answer = (
        "How was it made?",
        "Files, versions, settings, and every number of the summary.",
    )
    return Section("again", title, html, missing=missing, menu="Files", answer=answer)


def _command(contents: Contents) -> str:
    inputs = contents.record.metadata["replay_kit.inputs"]
    names = {key: text.rpartition(" sha256:")[0] for key, text in inputs.items()}
    logs = [names[key] for key in names if key.startswith("log")]
    goal = contents.record.metadata.get("replay_kit.options", {}).get("goal", "")
    parts = [
        "replay-kit",
        "replay",
        *logs,
        "--ensemble",
        *_ensemble(names),
        "--config",
        "config.toml",
    ]
    parts += [f"--goal={goal}"] if goal else []
    return (
        f"{shlex.join([*parts, '-o', contents.result.path.name])}\nreplay-kit verify "
        f"{shlex.quote(contents.result.path.name)} --inputs FOLDER"
    )


def _ensemble(names: dict[str, str]) -> list[str]:
    return [names[key] for key in names if key.startswith("ensemble")] or ["ENSEMBLE"]


def _input(name: str, text: str) -> list[str]:
    file, _, digest = text.rpartition(" sha256:")
    return [escape(name), escape(file), f"<code>{escape(digest)}</code>"]


def _settings(contents: Contents, missing: list[str]) -> str:
    toml = contents.record.config_toml
    if not toml:
        missing.append("The result does not hold its configuration.")
        return ""
    changed = changed_settings(toml)
    if not changed:
        return "<p>All settings have their defaults.</p>"
    rows = [
        [f"<code>{escape(key)}</code>", escape(json.dumps(value)), escape(json.dumps(default))]
        for key, value, default in changed
    ]
    return table_html(
        ["setting", "value", "default"], rows, "Settings that differ from their defaults"
    )


def _shortened(value: Any) -> Any:
    """Return nested values with a sentence in place of each long list: of a month they would be most of the page."""
    if isinstance(value, Mapping):
        return {key: _shortened(item) for key, item in value.items()}
    if isinstance(value, list):
        long = f"{len(value)} entries, in the JSON of replay-kit replay --json"
        return long if len(value) > _LONG else [_shortened(item) for item in value]
    return value


def _numbers(contents: Contents) -> str:
    rows = []
    for path, value in leaves(_shortened(contents.outcome.to_json())):
        exact = isinstance(value, int | float) and not isinstance(value, bool)
        shown = (
            number(path, value, f"{value:,}" if isinstance(value, int) else f"{value:.6g}")
            if exact
            else escape("unknown" if value is None else str(value))
        )
        rows.append([f"<code>{escape(path)}</code>", shown])
    return table_html(
        ["path in the summary", "value"], rows, "All numbers of the summary, as in --json"
    )
