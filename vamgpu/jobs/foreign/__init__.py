"""Patterns of other programs: read with the print data in their files, and written as jobs that can be proved."""
