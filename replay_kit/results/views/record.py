"""How a result was made: its metadata, its settings, and the summary of its run."""

import json
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from replay_kit.results.outcome.from_run import outcome_of
from replay_kit.results.outcome.outcome import Outcome, outcome_from
from replay_kit.results.reader import ResultReader
from replay_kit.results.result import ResultFile
from replay_kit.results.schemas import decode
from replay_kit.results.topics import CONFIG_NAME, SUMMARY_NAME


@dataclass(frozen=True, slots=True)
class RunRecord:
    """What a result states of its run.

    Attributes:
        metadata: Records by name, each with its keys and values; the digests are left out.
        config_toml: The configuration in effect; empty when the result has none.
        summary: As ``Outcome.to_record``; None when the result has none, as one of an unfinished run.
        vehicles: The same of each vehicle, by its name, where several share the estimate.
    """

    metadata: Mapping[str, Mapping[str, str]]
    config_toml: str
    summary: Mapping[str, Any] | None
    vehicles: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)


def read_record(reader: ResultReader) -> RunRecord:
    """Return what a result states of its run."""
    held = reader.attachments(lambda name: name.rpartition("/")[2] == SUMMARY_NAME)
    summaries = {name.rpartition("/")[0]: json.loads(one.data) for name, one in held.items()}
    config = reader.text(CONFIG_NAME)
    return RunRecord(reader.metadata, config, summaries.pop("", None), summaries)


def bathymetry_name(record: RunRecord) -> str:
    """Return the name of the bathymetry's file; what it is in words for a result that does not name it."""
    return (
        record.metadata.get("replay_kit.inputs", {})
        .get("bathymetry", "the bathymetry")
        .partition(" sha256:")[0]
    )


def changed_settings(config_toml: str) -> list[tuple[str, Any, Any]]:
    """Return the settings that differ from their defaults: table and key, value, default (None when it has none).

    A setting that this version does not know counts as changed.
    """
    # loads slowly, and few of what reads a result asks for its settings
    from replay_kit.config.run import RunConfig

    defaults, changed = RunConfig().model_dump(mode="json"), []
    for section, values in tomllib.loads(config_toml).items():
        known = defaults.get(section, {})
        changed += [
            (f"{section}.{key}", value, known.get(key))
            for key, value in values.items()
            if known.get(key) != value
        ]
    return changed


def outcome_of_result(result: ResultFile, record: RunRecord) -> Outcome:
    """Return the outcome that a result holds, or as much of it as its tables give.

    Args:
        result: The result; the score against a truth is not in the file, but may be in its summary.
        record: What the result states of its run.
    """
    if record.summary is None:
        return _from_tables(result)
    live = None if result.summary is None else outcome_of(result.summary)
    kept = outcome_of_record(record)
    return kept if live is None else replace(kept, seconds=live.seconds, truth=live.truth)


def outcome_of_record(record: RunRecord) -> Outcome:
    """Return the outcome that a result's summary states, which it must have, with those of its vehicles."""
    assert record.summary is not None
    each = {name: outcome_from(one).to_json() for name, one in record.vehicles.items()}
    return replace(outcome_from(record.summary), vehicles=each)


def leaves(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Yield each single value of nested mappings and lists with its path, such as ``by_dive.0.bins``."""
    if isinstance(value, Mapping):
        items = list(value.items())
    elif isinstance(value, list):
        items = [(str(number), item) for number, item in enumerate(value)]
    else:
        yield path, value
        return
    for key, item in items:
        yield from leaves(item, f"{path}.{key}" if path else str(key))


def plan_statistics(result: ResultFile) -> dict[str, str]:
    """Return the statistics of the last plan of a result, which must have one."""
    _, data = next(result.reader.messages("/plan/controls", newest=True))
    # Any: the fields are those of the table
    plan: Any = decode("Plan", data)
    return {pair.name: pair.value for pair in plan.statistics}


def _last_plan(result: ResultFile) -> dict[str, Any] | None:
    """Return the last plan of a result as far as its summary would have it; None without plans."""
    if not len(result.plans):
        return None
    plan = result.plans.iloc[-1]
    return (
        {name: plan[name] for name in ("status", "message")}
        | {"statistics": plan_statistics(result)}
        | {
            name: float(plan[name])
            for name in ("heading_deg", "glide_angle_deg", "speed", "duration", "closest_approach")
            if np.isfinite(plan[name])
        }
        | {f"{name}_j": float(plan[name]) for name in ("energy", "battery") if plan[name] > 0.0}
        | (
            {"odds": plan.filter(like="odds_").rename(lambda name: name[5:]).to_dict()}
            if plan["odds_n_samples"] > 0
            else {}
        )
    )


def _from_tables(result: ResultFile) -> Outcome:
    """Return what the tables of a result give of its outcome."""
    measured = result.measured
    used = measured.sums[measured.sums["accepted"].astype(bool)]
    count, dof = int(used["measurements"].sum()), float(used["dof"].sum())

    def rms(name: str) -> float | None:
        return float(np.sqrt(used[f"square_{name}"].sum() / dof)) if dof else None

    dives = [
        {
            "dive": int(number),
            "profiles": int(dive["profiles"]),
            "bins": int(dive["bins"]),
            "rms_innovation_predicted": None,
            "rms_innovation_prior": float(dive["rms_prior_innovation"]),
            "nis_per_dof": float(dive["nis_per_dof"]),
        }
        for number, dive in result.dives.iterrows()
    ]
    return Outcome(
        observations={
            "used": count,
            "rejected": measured.count - count,
            "bins_used": int(dof) // 2,
            "bins_rejected": measured.bins_rejected,
        },
        rms_innovation={
            "before": rms("innovation"),
            "after": rms("residual"),
            "prior": rms("prior_innovation"),
        },
        nis_per_dof=float(used["nis"].sum()) / dof if dof else None,
        by_dive=dives,
        plan=_last_plan(result),
        complete=False,
    )
