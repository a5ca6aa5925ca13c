"""MAVLink logs of ArduPilot and MAVLink telemetry."""
