"""Rigs and jobs: files, plans, and machines opened and checked."""
