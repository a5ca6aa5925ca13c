"""Status of a result on one screen, for the pilot at a surfacing."""
