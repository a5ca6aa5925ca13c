"""Plans that learn: surveys before a stretch without fixes, and the next profiles of a map."""
