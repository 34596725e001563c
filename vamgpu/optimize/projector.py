"""What methods project with: a volume that turns, or a web that passes."""

from __future__ import annotations

from vamgpu.operators.projection import Projection
from vamgpu.operators.web import WebProjection

Projector = Projection | WebProjection
