"""What ``import replay_kit`` offers to scripts."""
