"""Our own files damaged at random, through each command that reads them: no traceback, and no other answer without a word.

A damaged file is refused by name with exit code 3, or read with what was lost named and exit code 4, or answers as the sound one does.
"""

import pickle
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from replay_kit import open_estimate, open_result
from replay_kit.config.run import EstimatorConfig, OutputConfig, RunConfig
from replay_kit.core.errors import ReplayKitError
from replay_kit.logs import open_log
from replay_kit.workflows.follow.watch import Memory, read_memory, write_memory
from replay_kit.workflows.replay.checkpoint import read_state
from replay_kit.workflows.replay.inputs.job import ReplayJob
from tests.command import invoke
from tests.fuzz.mishap import KINDS as DAMAGES
from tests.fuzz.mishap import Mishap, mishap
from tests.workflows.replay.interrupted import Killed, make_ocean, run_until

_CONFIG = RunConfig(
    output=OutputConfig(checkpoint_interval=600.0), estimator=EstimatorConfig(modes=4)
)
_PLACES = "--start 152.2,-39.9,0 --goal 152.3,-39.8,100"
#: Kinds of our own files.
KINDS = ("estimate", "result", "plan", "state", "memory")
#: No hostile input takes longer [s].
MOST_S = 10.0


@dataclass(frozen=True)
class Answer:
    """What reading a file gave: its exit code, whether a loss or a missing checksum was named, what was said, and the content."""

    code: int
    told: bool
    said: str
    content: object


#: Reads a file at a path.
Reader = Callable[[Path], Answer]


class Own:
    """One of our own kinds of files: its name, path and bytes, and the commands or functions that read it."""

    def __init__(self, name: str, path: Path, readers: dict[str, Reader]) -> None:
        self.name, self.path, self.readers = name, path, readers
        self.data = path.read_bytes()


def check(own: Own, reader: str, sound: Answer, damage: Mishap) -> str:
    """Return what is wrong with the reading of a damaged file, empty for nothing."""
    if damage.data == own.data:
        return ""
    # a new file: arrays of the one before may be mapped
    own.path.unlink()
    own.path.write_bytes(damage.data)
    name, began = f"{own.name}, {reader}, {damage.what}", time.process_time()
    try:
        found = own.readers[reader](own.path)
    except ReplayKitError as error:
        # its own name or that of a copy; and what a user can do
        named = own.path.stem in str(error) or own.path.parent.name in str(error)
        return "" if error.exit_code == 3 and named else f"{name}: refused by {error}"
    except Exception as error:
        return f"{name}: {type(error).__name__}: {error}"
    if (seconds := time.process_time() - began) > MOST_S:
        return f"{name}: {seconds:.0f} s"
    same = (found.code, found.content) == (sound.code, sound.content)
    fine = same or found.code == 3 or (found.told and found.code in (0, 4))
    return "" if fine else f"{name}: exit {found.code}: {found.said[-300:]}"


def sweep(
    count: int, seed: int, folder: Path, slow: int = 1, names: tuple[str, ...] = KINDS
) -> Iterator[str]:
    """Yield what is wrong, empty for nothing, for that many damages of each kind of file.

    Args:
        count: Of damages of each kind; its readers take turns.
        seed: Of places and sizes.
        folder: Where files are made.
        slow: Readers that take seconds take their turn this many times more rarely; with 0 they are left out.
        names: Kinds of files.
    """
    for own in own_files(folder):
        if own.name not in names:
            continue
        quick = [name for name in own.readers if name not in _SLOW]
        readers = quick * slow + sorted(own.readers.keys() & _SLOW) if slow else quick
        turns = [readers[number // len(DAMAGES) % len(readers)] for number in range(count)]
        sound = {reader: own.readers[reader](own.path) for reader in set(turns)}
        for number, reader in enumerate(turns):
            yield check(own, reader, sound[reader], mishap(own.data, number, seed))
        own.path.write_bytes(own.data)


# A second and more each.
_SLOW = {"report", "plot", "plan", "verify"}


def own_files(folder: Path) -> list[Own]:
    """Return a sound file of each of our own kinds, made in a folder."""
    ocean = folder / "ocean"
    place, out, plan = ocean / "kept", ocean / "out.mcap", ocean / "plan.mcap"
    place.mkdir(parents=True)
    make_ocean(ocean, _CONFIG, 30)
    run = f"{ocean}/glider.mcap --ensemble {ocean}/ensemble.nc --modes 4 -q"
    for line in (
        f"replay {run} --goal 152.3,-39.8,100 --save-estimate {place}/flow.nc -o {out}",
        f"plan {out} {_PLACES} --samples 3 -o {plan} -q",
    ):
        done = invoke(line)
        assert done.exit_code in (0, 6), done.output
    state, inputs = place / "run.ck", ((ocean / "glider.mcap",), ocean / "ensemble.nc")
    with pytest.raises(Killed):
        run_until(ReplayJob(*inputs, ocean / "again.mcap", checkpoint=state), _CONFIG, 60)
    write_memory(place, Memory(said=("a log",) * 40, forecast="ensemble.nc sha256:0"))
    run_name, _ = pickle.loads(state.read_bytes().partition(b"\n")[2])
    commands = _result_commands(folder)
    of_plan = {name: commands[name] for name in ("report", "export", "convert", "info")}
    replay = _called(lambda path: pickle.dumps(read_state(path, run_name)))
    return [
        Own("estimate", place / "flow.nc", _ESTIMATE),
        Own("result", out, commands),
        Own("plan", plan, of_plan),
        Own("state", state, {"replay": replay}),
        Own("memory", place / "mission", {"follow": _called(lambda at: read_memory(at.parent))}),
    ]


def _ran(line: str, made: Path | None = None) -> Answer:
    done = invoke(line)
    if done.exit_code == 3 and isinstance(done.exception, ReplayKitError):
        raise done.exception
    words = ("LOST: ", "has no checksum", "Without a checksum", "Cannot be decoded")
    content = done.stdout if made is None else _content(made)
    return Answer(done.exit_code, any(word in done.output for word in words), done.output, content)


def _content(path: Path) -> object:
    if path.suffix != ".mcap":
        return path.read_bytes()
    with open_log(path) as log:
        return [(m.topic, m.log_ns, m.data) for m in log.raw_messages()]


def _called(read: Callable[[Path], object]) -> Reader:
    """Return the reading by a function, whose warnings tell of a loss."""

    def called(path: Path) -> Answer:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            content = read(path)
        return Answer(0, bool(caught), " ".join(str(one.message) for one in caught), content)

    return called


def _opened(path: Path) -> object:
    result = open_result(path)
    tables = [getattr(result, name).to_csv() for name in ("fixes", "observations", "plans")]
    return tables, repr(result.velocity_at(152.2, -39.9, 50.0))


_ESTIMATE: dict[str, Reader] = {
    "open_estimate": _called(
        lambda path: repr(open_estimate(path).velocity_at(152.2, -39.9, 50.0))
    ),
    "plan": lambda path: _ran(f"plan {path} {_PLACES} --samples 3 --json -"),
}


def _result_commands(folder: Path) -> dict[str, Reader]:
    """Return the commands that read a result, with what of their answer is compared."""
    made = {kind: folder / f"made.{kind}" for kind in ("csv", "nc", "html", "svg", "mcap")}
    o = {kind: f"--overwrite -o {path}" for kind, path in made.items()}
    return {
        "open_result": _called(_opened),
        "status": lambda path: _ran(f"status {path} --json -"),
        "export": lambda path: _ran(f"export {path} {o['csv']}", made["csv"]),
        "convert": lambda path: _ran(f"convert {path} {o['mcap']}", made["mcap"]),
        "info": lambda path: _ran(f"info {path} --json -"),
        "report": lambda path: _ran(f"report {path} {o['html']}", made["html"]),
        "plot": lambda path: _ran(f"plot {path} map {o['svg']}"),
        "plan": lambda path: _ran(f"plan {path} {_PLACES} --samples 3 --json -"),
        "verify": lambda path: _ran(f"verify {path} --inputs {path.parent} --json -"),
    }
