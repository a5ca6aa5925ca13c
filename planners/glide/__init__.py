"""One glide of constant heading and glide angle: the paper's planner."""
