"""Each command's work, one file or folder a command."""
