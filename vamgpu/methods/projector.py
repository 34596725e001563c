"""What methods project with: a volume that turns, or a web that passes, in light of any kind."""

from __future__ import annotations

from vamgpu.operators.compose import Derived
from vamgpu.operators.oblique import Oblique
from vamgpu.operators.projection import Projection
from vamgpu.operators.traced import TracedProjection
from vamgpu.operators.web import WebProjection

Projector = Projection | WebProjection | TracedProjection | Oblique | Derived
