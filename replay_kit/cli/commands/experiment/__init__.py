"""``experiment``: one file a study."""
