"""One module per command: options, call, output. Each imports its dependencies on call, so that help is quick."""
