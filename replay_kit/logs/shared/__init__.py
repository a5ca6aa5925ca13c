"""What the readers of several log formats share: read statistics, clocks, chains of records, payloads of our own messages."""
