"""Frames: packing them from plans, computing their light, exporting them, and job folders."""
