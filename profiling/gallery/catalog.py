"""The entries of the gallery, and how one is drawn."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from inspect import signature
from types import MappingProxyType
from typing import Any

from profiling.gallery.picture import Picture
from vamgpu.backend import open_device
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput
from vamgpu.reports.style import styled

GROUPS: dict[str, dict[str, str]] = {
    "Light in the resin": {
        "vial": "Light in a vial that turns in air",
        "beams": "Beams that are not ideal",
        "carried": "Lenses and inserts that turn with the resin",
        "roller": "A film that a roller carries past the light",
        "web": "A film that passes the light, at all angles at once",
        "eikonal": "Rays through media of varying index",
        "shadowgram": "The shadow of a print",
    },
    "Projection": {
        "projection": "A projection compared with its formula",
        "transpose": "The back projector is the transpose, entry by entry",
        "contrast": "Fewer angles: frequencies, spread and contrast",
        "exact": "A gray phantom reproduced exactly by light of both signs",
    },
    "Parts": {
        "targets": "The bundled parts",
        "voxels": "Partly filled voxels",
        "lattices": "Periodic solids, and one wound from film",
    },
    "Patterns": {
        "optimizers": "Every optimizer on one part",
        "optimum": "Optimum and certificate",
        "below": "Inside the voxel",
        "robust": "Patterns that tolerate machine errors",
        "sooner": "Window against time",
        "recipe": "The recipe of automatic exposure, step by step",
    },
    "Frames and focus": {
        "frames": "8-bit and 1-bit frames",
        "focus": "A focus that follows a roller",
        "calibration": "Focus and axis from recordings with noise",
    },
    "Endless webs": {
        "webs": "An endless web without a seam",
        "limits": "What a web machine can do, and what limits it",
    },
    "Resin": {
        "phase": "Two inhibitors under two colors of light",
        "efficiency": "What a second color of light adds",
        "transport": "Three species in a vial that turns",
        "materials": "Resins, glasses and diffusing species",
        "precompensation": "A dose that compensates for diffusing oxygen",
        "oxygen": "Patterns that follow oxygen",
        "history": "Resin that is reused",
        "scattering": "A resin that scatters light",
    },
    "Prints and their proof": {
        "travel": "A part that sinks, and one taller than the image",
        "proof": "A print, proved from its frames",
        "deviation": "How far prints lie from their mesh",
    },
    "Two colors of light": {
        "dualcolor": "One color, one color with a tolerance, and two colors",
        "printability": "Dose after each turn, two thresholds, and the allowed power",
        "joint": "Two colors optimized together, with the kinetics",
        "block": "A lattice block in one color and two, through the kinetics",
        "designs": "Dots, bars, wedges and posts in one color and two",
    },
    "Cure-through in stereolithography": {
        "curethrough": "Doses that cure a feature correctly",
        "correction": "Slices corrected for cure-through",
        "layerwise": "Cure-through layer by layer",
        "curethrough_part": "A part of bridges, corrected for cure-through",
    },
    "Machines": {
        "fom": "A calibration disk at five stop doses",
        "measured": "A rig that measures itself: focus, axis, gray levels, sharpness",
        "machines": "Prints on emulated machines, and how fast the light goes off",
        "live": "A print that is watched and replanned",
    },
}
"""Heading of the index → its entries."""
CATALOG: MappingProxyType[str, str] = MappingProxyType(
    {name: title for some in GROUPS.values() for name, title in some.items()}
)
"""Name → title. The function of that name in the module of that name makes the picture."""


def names() -> tuple[str, ...]:
    """Names of the entries."""
    return tuple(CATALOG)


def parameters(name: str) -> dict[str, Any]:
    """Parameters of an entry and their defaults, in mm and units made of it. Raises `BadInput`."""
    found = signature(_entry(name)).parameters.values()
    return {p.name: p.default for p in found if p.name not in ("device", "quick")}


def draw(name: str, device: str | Device | None = None, *, quick: bool = False, **values: Any) -> Picture:
    """Make the picture of an entry; ``values`` replace its parameters. quick: small sizes, for a fast look.

    Raises `BadInput` for a name or a parameter that does not exist, and the errors of the entry.
    """
    entry, known = _entry(name), parameters(name)
    for key in values:
        if key not in known:
            raise BadInput(f"{name} has no parameter {key!r}; it has {', '.join(known) or 'none'}")
    with styled():
        return entry(open_device(device), quick, **values)


def _entry(name: str) -> Callable[..., Picture]:
    if name not in CATALOG:
        raise BadInput(f"the gallery has no {name!r}; it has {', '.join(CATALOG)}")
    return getattr(import_module(f"profiling.gallery.{name}"), name)
