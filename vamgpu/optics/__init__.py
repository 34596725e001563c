"""Analytic optics of the vessels that hold the resin, in NumPy float64."""
