"""Expected surfacings beside the actual ones: as messages, as JSON and as sentences."""
