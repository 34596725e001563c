"""Protocols of the machines as values and bytes: nothing here opens a port, waits, or knows the time."""
