"""Tasks of several bodies: what is printed, what stands in the light, what stays open."""

from __future__ import annotations

from vamgpu.scene.body import Body
from vamgpu.scene.scene import Scene
from vamgpu.scene.web import WebPart

__all__ = ["Body", "Scene", "WebPart"]
