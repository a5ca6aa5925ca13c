"""What each kind of message states: payloads to positions, depths, attitudes, velocities and ADCP pings."""
