"""One module a command, `run(args)` -> exit status; only the one asked for is imported."""
