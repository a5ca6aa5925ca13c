"""Messages of unknown types, read as the configuration says."""
