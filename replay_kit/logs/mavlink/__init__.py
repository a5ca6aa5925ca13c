"""MAVLink telemetry logs, read and written."""
