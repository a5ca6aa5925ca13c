"""Layout files of viewers, with all panels of a result."""
