"""Stages of a replay: functions of frozen states, independent of writer and clock."""
