"""Missions of many dives."""
