"""Resins, inhibitors, glasses and liquids: numbers with their sources, from files that anybody can write."""

from vamgpu.chemistry.materials.clear_media import Clear, Glass, Liquid
from vamgpu.chemistry.materials.dispersion import Dispersion
from vamgpu.chemistry.materials.extinction import Extinction
from vamgpu.chemistry.materials.resin import Component, Inhibitor, Resin

__all__ = ["Clear", "Component", "Dispersion", "Extinction", "Glass", "Inhibitor", "Liquid", "Resin"]
