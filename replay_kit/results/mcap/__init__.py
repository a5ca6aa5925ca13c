"""The result as an MCAP file: its messages, topics, writer and reader of records."""
