"""Programs as methods: one JSON record a line on standard input, one answer a line on standard output before the next is sent."""

import contextlib
import json
import os
import queue
import shlex
import signal
import subprocess
from threading import Thread

from replay_kit.studies.bench.records import Answer, Record, answer_of_json

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

    def answer(self, record: Record) -> Answer:
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
