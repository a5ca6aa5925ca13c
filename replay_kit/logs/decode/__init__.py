"""Payloads of messages, decoded by their encoding."""
