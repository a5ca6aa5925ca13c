"""ADCP pings, from their payload to a profile of the current."""
