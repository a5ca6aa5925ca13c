"""Files: what may be an input, the paths of a command, complete writes."""
