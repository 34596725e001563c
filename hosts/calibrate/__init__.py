"""Calibrations measure a rig: machines move, mirrors show patterns, and a camera or photodiode measures."""
