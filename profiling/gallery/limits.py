"""Performance and limits of a web machine: speeds, time of an angle, flow, and the frequencies that light reaches."""

from __future__ import annotations

from math import inf, pi, radians
from typing import TYPE_CHECKING

from profiling.gallery.picture import Fact, Picture, Table
from vamgpu.backend.device import Device
from vamgpu.methods.papers import ROLL_TO_ROLL
from vamgpu.optics.film import Film
from vamgpu.optics.lens import TunableLens
from vamgpu.optics.roller import Roller
from vamgpu.units import Pa_s, kg_m3, minute, ms
from vamgpu.webs.display import Display
from vamgpu.webs.limits import WebLimits
from vamgpu.webs.limits_picture import figure_of

if TYPE_CHECKING:
    pass

PAPER_DENSITY = 1.1 * kg_m3
"""The density with which the paper computes its viscosity; a resin has a thousand times this density."""


def limits(
    device: Device,
    quick: bool = False,
    radius: float = 7.5,
    thickness: float = 3.0,
    step_deg: float = 0.5,
    bins: float = 3,
    settle_ms: float = 5.0,
    rate: float = 266.0,
    speed_mm_min: float = 48.0,
) -> Picture:
    """The machine of the roll-to-roll paper."""
    film = Film(thickness, 1.49, 1.33, 0.22)
    roller = Roller(radius, film, radians(step_deg), legs=0.5 * pi * (radius + 0.5 * thickness))
    lens = TunableLens(index=1.33, bins=int(bins), settle=settle_ms * ms)
    found = WebLimits(roller, lens, Display(rate), speed_mm_min / minute)
    limiting = found.limiting
    paper = WebLimits(roller, lens, found.display, found.speed, density=PAPER_DENSITY)
    facts = (
        Fact("sampling along the web at 1 mm/s", found.sampling_limit(1.0), "/mm", expected=66, source="paper, S12"),
        Fact("frames", found.frame_rate, "/s", 3, expected=30.6, source="48 mm/min, mid-line"),
        Fact("slot of a frame", 1e3 * found.slot, "ms", 3, expected=32.7, source="48 mm/min, mid-line"),
        Fact("data of 8-bit 1080p", found.data_rate / 1e6, "MB/s", 3, expected=63, source="48 mm/min, mid-line"),
        Fact("straight length of a window, to 5 % of light", found.window, "mm", expected=13.6, source="paper, S11"),
        Fact("angular coverage", found.coverage, "rad", expected=2.2, source="paper"),
        Fact("viscosity needed at 1.1 kg/m³", paper.viscosity_needed / Pa_s, "Pa·s",
             expected=43.7, source="paper, S13"),
        Fact("viscosity needed at 1100 kg/m³", found.viscosity_needed / Pa_s, "Pa·s", 3),
        Fact("defocus of the worst column", found.defocus, "mm", 3, 0.5 * found.depth_of_focus, "half a depth of focus",
             "≤"),
        Fact("greatest speed", limiting.speed * minute, "mm/min", 4),
    )  # fmt: skip
    reach = tuple((s.name, (s.speed * minute, s.speed / found.speed)) for s in found.speeds if s.speed < inf)
    table = Table(("limit", "speed [mm/min]", "divided by the design speed"), (".4g", ".3g"), reach)
    caption = (
        "Four limits on the speed of a web that turns by a fixed angle per frame: the mirrors' rate, the settling of "
        "the lens, the link to the lens, and their sum, because the machine does one after another. At the design "
        "speed, light can be on while the lens neither gets a command nor moves. The slower the web, the longer the "
        "uncured resin hangs in the light, and the more viscous it must be. A film in a bath of lower index gets light "
        "from a limited range of angles, so a wedge of spatial frequencies about its normal is missing."
    )
    return Picture(figure_of(found), caption, facts, table, (ROLL_TO_ROLL,))
