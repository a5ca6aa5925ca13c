"""Words and looks of values: units, times, counts, colours, progress."""
