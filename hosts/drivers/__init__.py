"""Drivers: thin, one machine each; what they need beyond the library is imported when a machine is opened.

A ``*_protocol`` is the bytes of a machine's line as values: it opens no port and knows no time. Emulators speak it too.
"""
