"""Cure-through of stereolithography: a model of the print of slices, and their correction."""
