"""The file of a web machine, for the tests of its reader and its schema."""

from __future__ import annotations

MACHINE = """\
# The machine of the roll-to-roll paper at its greatest speed.

[film]
thickness = "3 mm"
resin_index = 1.49
bath_index = 1.33
absorption = "2.2 1/cm"

[roller]
radius = "7.5 mm"
step = "0.5 deg"
legs = "14.14 mm"

[lens]
bins = 3
settle = "5 ms"
depth_of_focus = "3.8 mm"

[display]
rate = "266 Hz"
pixels = [1920, 1080]
pitch = "14.4 um"
bits = 8

[web]
speed = "48 mm/min"
length = "600 mm"

[resin]
density = "1100 kg/m3"
"""
