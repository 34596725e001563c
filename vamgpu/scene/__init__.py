"""Tasks of several bodies: those to print, those in the light path, and those to keep open."""

from vamgpu.scene.body import Body
from vamgpu.scene.scene import Scene

__all__ = ["Body", "Scene"]
