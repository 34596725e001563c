"""Tasks of several bodies: what is printed, what stands in the light, what stays open."""

from __future__ import annotations

from vamgpu.scene.body import Body
from vamgpu.scene.scene import Scene

__all__ = ["Body", "Scene"]
