"""ArduPilot's DataFlash logs."""
