"""Raw ADCP files of Teledyne and Nortek."""
