"""The log evidence of a run and of its rivals: as JSON and as sentences."""
