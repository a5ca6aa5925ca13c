"""Parts common to several log formats: read statistics, clocks, chains of records, payloads of our own messages."""
