"""Plans that learn: surveys before a stretch without fixes, the next profiles of a map, and whether a detour pays."""
