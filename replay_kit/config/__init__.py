"""Every setting with its default, unit and help: one model for TOML, command-line options and scripts."""
