"""Hosts drive the machines of a print: real devices or, for tests and dry runs, their emulators."""
