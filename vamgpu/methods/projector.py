"""Projectors for methods: a volume that turns, or a web that passes, in light of any kind."""

from __future__ import annotations

from vamgpu.operators.protocol import Operator

Projector = Operator
