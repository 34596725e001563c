"""Calibrations from recorded data: where the lens focuses and where the axis of rotation is."""
