"""Table of several vehicles with a common estimate, for summary, report and status."""

from collections.abc import Iterator, Mapping
from typing import Any

from replay_kit.results.outcome.outcome import Outcome
from replay_kit.show.numbers import Sentence, Shown

#: Headings of ``vehicle_rows``.
COLUMNS = (
    "vehicle",
    "used",
    "misfit before [cm/s]",
    "errors",
    "change without it [cm/s]",
    "errors without it",
    "plan",
    "verdict",
)
#: What the columns on data denial mean.
ABOUT_VALUE = (
    "change without it: RMS difference of the estimate at the published depths if the vehicle's observations are withheld; "
    "errors without it: ratio of those standard errors to the ones with all vehicles"
)


def vehicle_rows(outcome: Outcome) -> list[tuple[str, ...]]:
    """Return the rows of ``vehicle_cells`` as text."""
    return [tuple(str(Sentence([cell])) for cell in row) for row in vehicle_cells(outcome)]


def vehicle_cells(outcome: Outcome) -> list[tuple[str | Shown, ...]]:
    """Return a row for each vehicle, including those without observations."""
    rows = [_row(name, own, outcome.value.get(name, {})) for name, own in outcome.vehicles.items()]
    aside = [name for name in outcome.unused if name not in outcome.vehicles]
    return rows + [(name, "0", *[""] * (len(COLUMNS) - 3), "not used") for name in aside]


def _row(name: str, own: Outcome, value: Mapping[str, Any]) -> tuple[str | Shown, ...]:
    counts, plan, word = own.observations, own.plan, own.verdict.word
    error, without = (value.get(f"standard_error{end}") for end in ("", "_without"))
    found = [one["name"] for one in own.consistency]
    of, used = f"vehicles.{name}", counts["used"]
    return (
        name,
        Shown(f"{of}.observations.used", used, f"{used:,}"),
        _cm(f"{of}.rms_innovation.before", own.rms_innovation["before"]),
        own.errors_text.removeprefix("errors "),
        _cm(f"value.{name}.rms_change", value.get("rms_change")),
        f"{without / error:.2f}" if error and without else "",
        "" if plan is None else plan["status"],
        f"{word}: {found[0]}" if found else word,
    )


def vehicle_sentences(outcome: Outcome) -> Iterator[str]:
    """Yield sentences on alarms and notes of each vehicle."""
    for name, own in outcome.vehicles.items():
        yield from (f"ALARM: {name}: {alarm.text}" for alarm in own.alarms)
        yield from (f"Note: {name}: {note}" for note in own.notes)


def _cm(key: str, value: float | None) -> str | Shown:
    return "" if value is None else Shown(key, value, f"{100.0 * value:.2f}")
