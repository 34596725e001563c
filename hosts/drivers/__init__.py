"""Thin drivers, each for one machine; packages beyond the library are imported when a machine is opened.

A ``*_protocol`` turns the bytes of a machine's line into values, without ports and times. Emulators also use it.
"""
