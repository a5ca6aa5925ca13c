"""Tests of missions by multiple shooting."""
