"""The command line: one module per command, `app` on top."""
