"""What a script holds in memory as the files that a replay reads, so that its result can be verified."""
