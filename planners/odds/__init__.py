"""The odds of a mission: gliders steered along it in samples of the estimate."""
