"""Schedules of frames: exact tables of slots, and limits of machines."""
