"""What a run found, as one value: what its summary, its JSON, the status, the report and the table of a fleet show."""
