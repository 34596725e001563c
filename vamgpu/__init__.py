"""vamgpu: tomographic volumetric 3D printing, from the optics of a vial to the frames of a projector.

``import vamgpu`` loads only NumPy of the large packages; others load when first used.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

_PUBLIC = {
    "devices": "vamgpu.backend",
    "open_device": "vamgpu.backend",
    "Grid": "vamgpu.geometry",
    "Beam": "vamgpu.geometry",
    "Turntable": "vamgpu.geometry",
    "WebGrid": "vamgpu.web",
    "projector": "vamgpu.operators.projector",
    "Projection": "vamgpu.operators.projection",
    "PolarGrid": "vamgpu.operators.polar",
    "RingProjection": "vamgpu.operators.ring_projection",
    "SpectralProjection": "vamgpu.operators.spectral",
    "WebProjection": "vamgpu.operators.web",
    "TracedProjection": "vamgpu.operators.traced_projection",
    "CoRotatingMedium": "vamgpu.operators.medium",
    "RayBundle": "vamgpu.operators.bundle",
    "Oblique": "vamgpu.operators.oblique",
    "Defocus": "vamgpu.operators.defocus",
    "Defocused": "vamgpu.operators.defocus",
    "Scattering": "vamgpu.optics.scattering",
    "ScatteringRings": "vamgpu.operators.scattering_rings",
    "Tiles": "vamgpu.operators.shifts",
    "Wobble": "vamgpu.operators.wobble",
    "Wobbled": "vamgpu.operators.shifts",
    "Vial": "vamgpu.optics.vial",
    "Vat": "vamgpu.optics.vat",
    "DoubleWalledVial": "vamgpu.optics.double_walled_vial",
    "SquareBath": "vamgpu.optics.square_bath",
    "GradedVial": "vamgpu.optics.graded_vial",
    "Misaligned": "vamgpu.optics.beams",
    "Fan": "vamgpu.optics.beams",
    "Occluded": "vamgpu.optics.occluder",
    "Cone": "vamgpu.optics.rising_beams",
    "Inclined": "vamgpu.optics.rising_beams",
    "Film": "vamgpu.optics.film",
    "Roller": "vamgpu.optics.roller",
    "TunableLens": "vamgpu.optics.lens",
    "resin_pixel": "vamgpu.optics.sampling",
    "enough_angles": "vamgpu.optics.sampling",
    "Target": "vamgpu.targets.target",
    "Body": "vamgpu.scene",
    "Scene": "vamgpu.scene",
    "optimize": "vamgpu.methods",
    "Plan": "vamgpu.methods",
    "BCLP": "vamgpu.methods",
    "LBFGS": "vamgpu.methods",
    "OSMO": "vamgpu.methods",
    "FilteredBackProjection": "vamgpu.methods",
    "GradientDescent": "vamgpu.methods",
    "PenaltyMinimization": "vamgpu.methods",
    "Recipe": "vamgpu.methods",
    "SurfaceRamp": "vamgpu.methods",
    "Tolerances": "vamgpu.methods",
    "Frames": "vamgpu.printing.frames",
    "GrayCurve": "vamgpu.printing.gray",
    "FocusMasks": "vamgpu.printing.focus",
    "pack": "vamgpu.printing.pack",
    "export": "vamgpu.printing.export",
    "simulate": "vamgpu.printing.simulate",
    "Proof": "vamgpu.printing.proof",
    "load": "vamgpu.jobs.load",
    "Stream": "vamgpu.webs.stream",
    "timetable": "vamgpu.webs.timetable",
    "Resin": "vamgpu.chemistry.materials",
    "Diffusion": "vamgpu.chemistry.diffusion",
    "Spread": "vamgpu.chemistry.diffusion",
    "PrintRun": "vamgpu.chemistry.printrun",
    "plan_exposure": "vamgpu.chemistry.exposure_plan",
    "RotatingLight": "vamgpu.chemistry.efficiency",
    "fit_aging": "vamgpu.chemistry.aging",
    "fit_induction": "vamgpu.chemistry.induction",
    "stationary": "vamgpu.chemistry.phase_plane",
    "Colors": "vamgpu.methods.dual",
    "superpose": "vamgpu.methods.dual",
    "LossWeights": "vamgpu.methods.joint",
    "KineticModel": "vamgpu.methods.joint",
    "TwoColorResin": "vamgpu.methods.joint",
    "optimize_colors": "vamgpu.methods.joint",
    "compared": "vamgpu.methods.compare",
    "merit": "vamgpu.metrics.merit",
    "shadowgram": "vamgpu.optics.shadowgram",
    "Spiral": "vamgpu.targets.spiral",
    "gray_wedges": "vamgpu.targets.designs",
    "usaf": "vamgpu.targets.designs",
    "live": "vamgpu.hosts.live.live_print",
}
"""Public name → module that defines it."""

__version__ = "0.3.0.dev0"
__all__ = [*_PUBLIC, "__version__"]  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    if name not in _PUBLIC:
        raise AttributeError(f"vamgpu has no {name!r}; it has {', '.join(_PUBLIC)}")
    if name == "live":  # the package of that name, which prints when it is called
        return import_module("vamgpu.live")
    return getattr(import_module(_PUBLIC[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
