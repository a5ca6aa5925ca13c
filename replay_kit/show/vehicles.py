"""Table of several vehicles with a common estimate, for summary, report and status."""

from collections.abc import Iterator

from replay_kit.results.outcome.outcome import Outcome
from replay_kit.show.numbers import Sentence, Shown

#: Headings of ``vehicle_rows``.
COLUMNS = (
    "vehicle",
    "used",
    "misfit before [cm/s]",
    "errors",
    "plan",
    "verdict",
)


def vehicle_rows(outcome: Outcome) -> list[tuple[str, ...]]:
    """Return the rows of ``vehicle_cells`` as text."""
    return [tuple(str(Sentence([cell])) for cell in row) for row in vehicle_cells(outcome)]


def vehicle_cells(outcome: Outcome) -> list[tuple[str | Shown, ...]]:
    """Return a row for each vehicle, including those without observations."""
    rows = [_row(name, own) for name, own in outcome.vehicles.items()]
    aside = [name for name in outcome.unused if name not in outcome.vehicles]
    return rows + [(name, "0", *[""] * (len(COLUMNS) - 3), "not used") for name in aside]


def _row(name: str, own: Outcome) -> tuple[str | Shown, ...]:
    counts, plan, word = own.observations, own.plan, own.verdict.word
    found = [one["name"] for one in own.consistency]
    of, used = f"vehicles.{name}", counts["used"]
    return (
        name,
        Shown(f"{of}.observations.used", used, f"{used:,}"),
        _cm(f"{of}.rms_innovation.before", own.rms_innovation["before"]),
        own.errors_text.removeprefix("errors "),
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
