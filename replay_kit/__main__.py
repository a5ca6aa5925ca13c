"""``python -m replay_kit`` is the command ``replay-kit``."""

from replay_kit.cli import main

main()
