"""Drivers: thin, one machine each; what they need beyond the library is imported when a machine is opened."""
