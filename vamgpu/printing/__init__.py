"""Frames of plans, and the light of frames: packing, exporting, job folders."""
