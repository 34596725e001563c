"""Calibrations from recorded data: the focus of the lens and the axis of rotation."""
