"""In-memory inputs of a script as the files that a replay reads, so that its result can be verified."""
