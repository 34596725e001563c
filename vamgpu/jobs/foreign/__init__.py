"""Patterns of other programs: read with what their files say of the print, and written as jobs that are proven."""
