"""The planning service: gRPC handlers, admission, and everything from the start of a server to its end."""
