"""Tasks on dives as records: what is known, what is asked, what an answer states; and programs as methods.

A program gets one JSON record a line on standard input, and gives one answer a line on standard output before the next is sent.
"""

import contextlib
import json
import math
import os
import queue
import shlex
import signal
import subprocess
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from threading import Thread
from typing import Any

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.estimator.next_dive.mixtures import Mixture, Persistence
from replay_kit.studies.bench.missions import Dive, Mission

#: Tasks on dives' mean currents, and on currents by depth.
MEAN_TASKS = ("next-dive", "planned-dive", "deny-dive", "deny-day")
PROFILE_TASKS = ("profile", "deny-adcp")
DIVE_TASKS = (*MEAN_TASKS, *PROFILE_TASKS)
_DAY_NS = 86_400 * 10**9


@dataclass(frozen=True, slots=True, eq=False)
class Answer:
    """What a method says of a record.

    Attributes:
        velocity: shape (n, 2) [m/s], true east and north; one row for a mean current.
        std: shape (n, 2) [m/s], of each component; None where it is not stated.
        stated: Distribution of a mean current; None for the Gaussian of ``std``, if that is known.
    """

    velocity: Array
    std: Array | None = None
    stated: Mixture | Persistence | None = None

    @classmethod
    def of_mixture(cls, mixture: Mixture) -> "Answer":
        """Return the answer that states Gaussians of a mean current."""
        std = np.sqrt(np.diag(mixture.cov))
        return cls(mixture.mean[None], std[None], mixture)


@dataclass(frozen=True, slots=True, eq=False)
class Record:
    """What a method is asked.

    Attributes:
        task: Of ``DIVE_TASKS``.
        mission: Its name.
        target: The dive to predict, without what is asked of it.
        truth: shape (n, 2) [m/s], what was measured; no method reads it.
        given: Dives that have become known since the record before.
        known: All known dives, in order.
        backgrounds: shape (2, n, 2) [m/s], by the forecast alone and by the estimate; NaN where they say nothing, None without them.
    """

    task: str
    mission: str
    target: Dive
    truth: Array
    given: tuple[Dive, ...]
    known: tuple[Dive, ...]
    backgrounds: Array | None = None

    def json(self, from_the_first: bool = False) -> dict[str, Any]:
        """Return it as sent to a program; with all known dives as new to one that has just been started."""
        dives = self.known if from_the_first else self.given
        return {
            "task": self.task,
            "mission": self.mission,
            "given": [_dive_json(dive) for dive in dives],
            "target": _dive_json(self.target),
        }


def _dive_json(dive: Dive) -> dict[str, Any]:
    return {
        "dive": dive.number,
        "begin_ns": dive.begin_ns,
        "end_ns": dive.end_ns,
        "place": [each if math.isfinite(each) else None for each in dive.place],
        "way": None if dive.way is None else dive.way.tolist(),
        "mean": None if dive.mean is None else dive.mean.tolist(),
        "depth": dive.depth.tolist(),
        "velocity": dive.velocity.tolist(),
    }


def answer_of_json(said: Any, rows: int) -> Answer:
    """Return a program's answer: ``velocity``, and where it states errors ``std`` or, of a mean current, ``cov``.

    Args:
        said: The decoded line.
        rows: Number of velocities asked.

    Raises:
        ValueError: It is no such object, or a number is not finite, or an error not above 0.
    """
    if not isinstance(said, Mapping) or "velocity" not in said:
        raise ValueError("expected an object with velocity")
    velocity = _numbers(said["velocity"], (rows, 2), "velocity")
    if said.get("cov") is not None:
        cov = _numbers(said["cov"], (2, 2), "cov")
        if rows != 1 or np.any(np.linalg.eigvalsh(cov) <= 0.0):
            raise ValueError("cov: expected a positive definite matrix of one mean current")
        return Answer.of_mixture(Mixture(np.zeros(1), velocity.T, cov[..., None]))
    if said.get("std") is None:
        return Answer(velocity)
    std = _numbers(said["std"], (rows, 2), "std")
    if np.any(std <= 0.0):
        raise ValueError("std: expected numbers above 0")
    if rows == 1:
        return Answer.of_mixture(Mixture(np.zeros(1), velocity.T, np.diag(std[0] ** 2)[..., None]))
    return Answer(velocity, std)


def _numbers(value: Any, shape: tuple[int, int], name: str) -> Array:
    try:
        found = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"{name}: expected numbers") from None
    if found.shape != shape or not np.isfinite(found).all():
        raise ValueError(f"{name}: expected finite numbers of shape {shape}, got {found.shape}")
    return found


def records(task: str, mission: Mission) -> Iterator[Record]:
    """Yield what is asked of a mission, dive after dive that has what is asked; the first ones without a known dive.

    ``next-dive`` is predicted from all dives before it, ``deny-dive`` without the last of these, ``deny-day`` without those of the day
    before; ``planned-dive`` does not know the way through the water. ``profile`` is the current by depth of the next dive; in
    ``deny-adcp`` the instrument is withheld: only mean currents are known, that of the dive itself among them.
    """
    dives = mission.dives
    if task == "deny-adcp":
        dives = tuple(replace(dive, given=_paths(dive)) for dive in dives)
    sent = 0
    for k, dive in enumerate(dives):
        known = dives[: max(k - 1, 0)] if task == "deny-dive" else dives[:k]
        if task == "deny-day":
            known = tuple(each for each in known if each.end_ns <= dive.begin_ns - _DAY_NS)
        if task == "deny-adcp":
            known = tuple(_without_bins(each) for each in known)
        truth = _truth(task, dive)
        if truth is None:
            continue
        target = replace(dive, velocity=np.empty((0, 2)), given=(), inverted=None)
        if task in MEAN_TASKS:
            target = replace(target, mean=None, depth=np.empty(0))
        elif task == "profile":
            target = replace(target, mean=None)
        if task == "planned-dive":
            target = replace(target, way=None)
        yield Record(task, mission.name, target, truth, known[sent:], known)
        sent = len(known)


def _paths(dive: Dive) -> tuple[Any, ...]:
    return () if dive.path is None else (dive.path,)


def _without_bins(dive: Dive) -> Dive:
    return replace(dive, depth=np.empty(0), velocity=np.empty((0, 2)))


def _truth(task: str, dive: Dive) -> Array | None:
    if task in PROFILE_TASKS:
        return dive.velocity if dive.depth.size else None
    if task == "planned-dive" and dive.way is None:
        return None
    return None if dive.mean is None else dive.mean[None]


# Starts of a program in one mission, after which it is not asked again.
_STARTS = 3
# Characters of a line at most.
_LONGEST = 10_000_000


class UnansweredError(Exception):
    """A record without a usable answer; its text says why."""


class Program:
    """A program that is started when it is first asked, and again after it was late or ended."""

    def __init__(self, command: str, seconds: float) -> None:
        """Begin without starting it.

        Args:
            command: As in a shell, without its operators.
            seconds: Allowed for each record.
        """
        self._words, self._seconds = shlex.split(command), seconds
        self._running: subprocess.Popen[str] | None = None
        self._starts = 0

    def __call__(self, record: Record) -> Answer:
        """Return the program's answer.

        Raises:
            UnansweredError: It is late, has ended, or its line is no answer.
        """
        started = self._running is None
        if started:
            self._start()
        line = json.dumps(record.json(from_the_first=started), allow_nan=False)
        box: queue.SimpleQueue[str] = queue.SimpleQueue()
        Thread(target=self._exchange, args=(line, box), daemon=True).start()
        try:
            said = box.get(timeout=self._seconds)
        except queue.Empty:
            self.close()
            raise UnansweredError(f"no answer within {self._seconds:g} s") from None
        if not said.endswith("\n"):
            self.close()
            raise UnansweredError("it ended without an answer")
        try:
            return answer_of_json(json.loads(said), len(record.truth))
        except (ValueError, RecursionError) as error:
            raise UnansweredError(f"no usable answer: {str(error)[:200]}") from None

    def close(self) -> None:
        """End the program and what it started."""
        if self._running is not None:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self._running.pid, signal.SIGKILL)
            self._running.wait()
            for pipe in (self._running.stdin, self._running.stdout):
                # what a program did not read cannot be flushed
                with contextlib.suppress(OSError):
                    if pipe is not None:
                        pipe.close()
            self._running = None

    def _start(self) -> None:
        if self._starts == _STARTS:
            raise UnansweredError(f"it was late or ended {_STARTS} times and is not started again")
        self._starts += 1
        try:
            self._running = subprocess.Popen(
                self._words,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                encoding="utf-8",
                errors="replace",
                start_new_session=True,
            )
        except OSError as error:
            self._starts = _STARTS
            raise UnansweredError(f"it cannot be started: {error.strerror}") from None

    def _exchange(self, line: str, box: "queue.SimpleQueue[str]") -> None:
        running = self._running
        assert running is not None
        assert running.stdin is not None
        assert running.stdout is not None
        try:
            running.stdin.write(line + "\n")
            running.stdin.flush()
            box.put(running.stdout.readline(_LONGEST))
        except (OSError, ValueError):
            # it has ended or was ended
            box.put("")
