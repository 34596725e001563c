"""Methods find light for every kind of projector, not only for straight rays and vials."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest

import vamgpu as vam
from vamgpu.errors import BadInput
from vamgpu.methods import optimize
from vamgpu.operators.blur import Blur
from vamgpu.operators.bundle import RayBundle
from vamgpu.operators.compose import Composed, Sum
from vamgpu.operators.defocus import Defocus, Defocused
from vamgpu.operators.medium import CoRotatingMedium
from vamgpu.operators.oblique import Oblique
from vamgpu.operators.shifts import Tiles, Wobbled
from vamgpu.operators.traced_projection import TracedProjection
from vamgpu.operators.web import WebProjection
from vamgpu.operators.wobble import Wobble
from vamgpu.optics.beams import Misaligned
from vamgpu.optics.film import Film
from vamgpu.optics.rising_beams import Cone
from vamgpu.optics.roller import Roller
from vamgpu.web import WebGrid

GRID, BEAM, MOTION = vam.Grid((20, 20, 6), 0.1), vam.Beam((22, 8), 0.1), vam.Turntable(24)
BENT = 1.5 + 0.03 * np.random.default_rng(0).random(GRID.shape[:2])


def straight(vessel: Any = None) -> vam.Projection:
    return vam.Projection(GRID, BEAM, MOTION, vessel)


def blurred() -> Composed:
    A = straight()
    return Composed(Blur(A.range, A.device, np.array([0.6, 0.2]), np.array([1.0])), A)


KINDS: dict[str, Callable[[], Any]] = {
    "carried index": lambda: TracedProjection(GRID, BEAM, MOTION, CoRotatingMedium(BENT, bath=1.5)),
    "fan of rays": lambda: TracedProjection(GRID, BEAM, MOTION, rays=RayBundle.fan(BEAM, 20.0)),
    "cone": lambda: Oblique(GRID, BEAM, MOTION, Cone(throw=20.0)),
    "out of focus": lambda: Defocused(straight(), Defocus(0.08, 6.0), 0.1),
    "wobble": lambda: Wobbled(straight(), Wobble.circle(0.05, 0.3, MOTION)),
    "tiles": lambda: Tiles(straight(), 5, 1),
    "sub-rays": lambda: Sum([straight(Misaligned(tilt=t)) for t in (-0.02, 0.02)], [0.5, 0.5]),
    "blurred": blurred,
}


def part(shape: tuple[int, ...]) -> np.ndarray:
    """A bar off the middle, [x, y, z] or [l, rho, z]."""
    solid = np.zeros(shape, np.float32)
    solid[6:14, shape[1] // 3 : shape[1] // 3 + max(2, shape[1] // 4), 1:-1] = 1.0
    return solid


@pytest.mark.parametrize(
    "method", ["default", *(pytest.param(name, marks=pytest.mark.slow) for name in ("osmo", "fbp", "bclp"))]
)
@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_of_projector_prints(kind: str, method: str) -> None:
    assert share(KINDS[kind](), method) > 0.85 * plain(method)


def share(A: Any, method: str) -> float:
    """Mean dose in the part over that around it, of light that a method found."""
    solid = part(GRID.shape)
    plan = optimize(A, solid, method, 8)
    assert plan.sinogram.shape == A.range.shape and plan.sinogram.numpy().min() >= 0.0
    dose, disc = plan.dose().numpy(), np.broadcast_to(GRID.cylinder()[..., None], GRID.shape)
    return float(dose[solid > 0].mean() / dose[disc & (solid == 0)].mean())


@cache
def plain(method: str) -> float:
    """The same of straight rays."""
    return share(straight(), method)


def test_a_web_wider_than_its_beam_is_exposed_in_tiles() -> None:
    roller = Roller(1.0, Film(0.6, 1.49, 1.33, 0.5), 0.1, legs=0.3)
    grid, beam = WebGrid((40, 6, 12), (roller.advance, 0.1, 0.1)), vam.Beam((30, 12), 0.1)
    whole = WebProjection(grid, beam, roller)
    A = Tiles(whole, rows=7, overlap=2)
    assert A.range.shape == (2 * whole.motion.poses, 30, 7) and A.dot_test() <= 2e-8
    light = np.random.default_rng(1).random(whole.range.shape).astype(np.float32)
    assert np.abs(A.T(A.split(light)) - whole.T(light)).max() <= 1e-5 * whole.T(light).max()
    plan = optimize(A, part(grid.shape), "bclp", 10)
    dose, inside = plan.dose().numpy(), part(grid.shape) > 0
    assert dose[inside].mean() > 1.5 * dose[~inside].mean()


def test_what_projects_nothing_is_refused() -> None:
    A = straight()
    blur = Blur(A.range, A.device, np.array([1.0]), np.array([1.0]))
    with pytest.raises(BadInput, match="expected a projector"):
        optimize(Composed(blur, blur), np.ones(A.range.shape, np.float32))
