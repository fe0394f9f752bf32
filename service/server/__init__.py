"""The planning service: handlers of the gRPC methods, admission, jobs, and start and end of the server."""
