"""Periodic solids as functions of space, for vials and endless webs: minimal surfaces, trusses and capsules.

Arguments are x, y, z, or l, ρ, z on a web; lengths in mm; the solid is where the value is negative.
"""

from vamgpu.targets.lattices.capsules import Capsules
from vamgpu.targets.lattices.tpms import SchwarzP, SheetGyroid, SkeletalDiamond, SkeletalGyroid
from vamgpu.targets.lattices.trusses import CubicLattice, OctetTruss, Pentamode

__all__ = [
    "Capsules",
    "CubicLattice",
    "OctetTruss",
    "Pentamode",
    "SchwarzP",
    "SheetGyroid",
    "SkeletalDiamond",
    "SkeletalGyroid",
]
