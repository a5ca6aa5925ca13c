"""A result on one screen: what a pilot asks at a surfacing."""
