"""Prior of the current, fitted to an ensemble."""
