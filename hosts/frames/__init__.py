"""Frames, packed and uploaded to the mirrors' memory ahead of their time."""
