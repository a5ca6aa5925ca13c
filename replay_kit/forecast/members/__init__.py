"""Members of an ensemble: which fields of which files they are, at which time."""
