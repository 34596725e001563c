"""Cure-through of stereolithography: modeled from slices, and corrected in them."""
