"""Coverage-guided fuzzing, by hand: ``python -m tests.fuzz.guided NAME SECONDS``; needs the extra ``fuzz``.

An input that breaks a parser is written to the working directory as ``crash-*``: mend the parser, and keep the input in ``corpus/NAME``.
"""

import sys
import tempfile

import atheris

with atheris.instrument_imports(
    include=[
        "replay_kit.logs",
        "replay_kit.config",
        "replay_kit.forecast",
        "replay_kit.workflows",
        "mhkit.dolfyn",
        "tomllib",
    ]
):
    from tests.fuzz.parsers import CORPUS, PARSERS


def run(name: str, seconds: int) -> int:
    """Fuzz one parser for a time, from its corpus; libFuzzer ends the process."""
    if name not in PARSERS:
        print(f"expected one of {', '.join(PARSERS)}, got {name}", file=sys.stderr)
        return 2
    with tempfile.TemporaryDirectory() as found:
        limits = [
            f"-max_total_time={seconds}",
            "-timeout=10",
            "-rss_limit_mb=600",
            "-max_len=16384",
            "-print_final_stats=1",
        ]
        atheris.Setup([sys.argv[0], found, str(CORPUS / name), *limits], PARSERS[name])
        atheris.Fuzz()
    return 0


if __name__ == "__main__":
    sys.exit(run(sys.argv[1], int(sys.argv[2])))
