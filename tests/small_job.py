"""The beginning of a small job: a boat of 12 voxels in a refracting vial."""

BOAT = """
[target]
shape = "boat"
height = "1.2 mm"
pitch = "100 um"
[vial]
radius = "4 mm"
wall = "0.5 mm"
resin_index = 1.5
wall_index = 1.47
absorption = "0.05 /mm"
[beam]
pitch = "150 um"
[turntable]
angles = 24
"""
