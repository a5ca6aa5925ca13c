"""``verify``: a result made again and compared."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated

from replay_kit.cli.console import console_beside, progress, write_json
from replay_kit.cli.options import INPUTS, TO_OUTPUTS, Answer, argument, option
from replay_kit.core.paths import check_paths


def verify(
    result: Annotated[Path, argument("OUT.mcap", "A result of replay or plan.")],
    /,
    *,
    inputs: Annotated[
        list[Path] | None,
        option(
            "--inputs",
            "Folder of the inputs; may be repeated. Default: the result's folder, then the current one.",
            metavar="DIR",
            group=INPUTS,
        ),
    ] = None,
    answer: Annotated[Answer, TO_OUTPUTS] = Answer(),
) -> int:
    """Return 0, 4 when part of the result was lost, or 5 when it could not be made again."""
    check_paths([result], [answer.json_file], answer.overwrite)

    from replay_kit.workflows.planning import planner_of
    from replay_kit.workflows.planning.again import plan_again
    from replay_kit.workflows.sound import sound_result
    from replay_kit.workflows.verify import print_verdict, verdict_json
    from replay_kit.workflows.verify import verify as verify_result

    with progress() as advance, sound_result(result) as sound:
        folders = [*(inputs or ()), result.parent]
        verdict = verify_result(sound.path, folders, planner_of, advance, plan_again)
    verdict = replace(verdict, result=result, notes=(*sound.lines, *verdict.notes))
    print_verdict(verdict, console_beside(answer.json_file))
    write_json(answer.json_file, verdict_json(verdict))
    return sound.exit_code or (0 if verdict.same else 5)
