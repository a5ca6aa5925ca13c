"""The quality control of a mission's logs."""
