"""Hosts: what drives the machines of a print; the real devices and, for tests and rehearsals, their emulators."""
