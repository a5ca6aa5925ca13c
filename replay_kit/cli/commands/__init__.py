"""One file a command: its options, what it calls, what it prints. Each loads what it needs when it is called, so that help is quick."""
