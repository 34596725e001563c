"""Light found on rings: as good as that of rays through each voxel, and kept and proven as any other."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import vamgpu as vam
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput
from vamgpu.targets import shapes

VIAL = vam.Vial(radius=4.2, wall=0.4, resin_index=1.49962, wall_index=1.473, absorption=0.05)


def boat(device: Device | str | None, pitch: float, height: float = 3.7) -> tuple[vam.Target, vam.Projection]:
    target = vam.Target.from_mesh(shapes.build("boat"), height=height, pitch=pitch, device=device)
    beam = vam.Beam((round(1.5 * target.grid.shape[0]), target.grid.shape[2] + 4), 1.4 * pitch)
    return target, vam.Projection(target.grid, beam, vam.Turntable(180), VIAL, device)


def proven(plan: Any, target: vam.Target) -> float:
    return vam.simulate(plan.operator, vam.pack(plan, bits=8), target).scores.window


@pytest.mark.slow
@pytest.mark.parametrize("method", ["ramp", "osmo", "recipe"])
def test_light_found_on_rings_proves_as_well(fast_device: Device, is_quick: bool, method: str) -> None:
    """By rays that are traced apart from both."""
    pitch, less = (0.1, 0.003) if is_quick else (0.3, 0.03)
    target, A = boat(fast_device, pitch)
    rays, rings = (vam.optimize(one, target, method) for one in (A, vam.RingProjection.of(A)))
    assert rays.evaluations == rings.evaluations
    assert proven(rings, target) >= proven(rays, target) - less


@pytest.mark.parametrize("method", ["default", "osmo", "lbfgs", "bclp", "penalty"])
def test_every_method_takes_rings(method: str) -> None:
    target, A = boat(None, 0.5)
    plan = vam.optimize(vam.RingProjection.of(A), target, method, evaluations=6)
    assert plan.window > -1.0 and float(plan.sinogram.numpy().max()) > 0.0


@pytest.mark.parametrize("tolerances", [None, vam.Tolerances(axis=0.05)])
def test_what_a_plan_claims_is_by_rays(tolerances: Any) -> None:
    """Also on rings so wide that they err."""
    target, A = boat(None, 0.5)
    plan = vam.optimize(vam.RingProjection.of(A, 1.5), target, evaluations=8, tolerances=tolerances)
    assert abs(plan.window - plan.history[-1].window) > 1e-3
    if tolerances is None:
        dose, part = np.asarray(A.T(plan.sinogram.numpy())), target.numpy() >= 0.5
        near = np.broadcast_to(target.grid.cylinder()[:, :, None], part.shape)
        worth = (dose[part & near].min() - dose[~part & near].max()) / dose[near].max()
    else:
        worth = tolerances.doses(A, plan, target).window
    assert plan.window == pytest.approx(worth, abs=1e-5)


def test_a_projection_on_rings_is_asked_for_the_dose_of_voxels() -> None:
    target, A = boat(None, 0.5)
    rings = vam.RingProjection.of(A).rings
    plan = vam.optimize(vam.SpectralProjection(rings, A.beam, VIAL, A.device), target, iterations=2)
    assert isinstance(plan.operator, vam.RingProjection)
    assert (plan.operator.rings, plan.operator.grid) == (rings, target.grid)
    other = vam.PolarGrid(rings.rings, rings.slices + 2, rings.pitch, rings.angles, rings.height)
    with pytest.raises(BadInput, match="same angles and slices"):
        vam.optimize(vam.SpectralProjection(other, A.beam, VIAL, A.device), target)


@pytest.mark.slow
def test_plans_are_kept_resumed_and_proven(tmp_path: Path) -> None:
    target, A = boat(vam.open_device(None), 0.4)
    R: Any = vam.RingProjection.of(A)
    half, whole = (vam.optimize(R, target, iterations=n) for n in (3, 5))
    half.save(tmp_path / "half.vam")
    again: Any = vam.load(tmp_path / "half.vam", device=A.device)
    assert isinstance(again.operator, vam.RingProjection) and again.operator.rings == R.rings
    assert "RingProjection" in repr(again.operator)
    np.testing.assert_array_equal(
        vam.optimize(again.operator, again.target, iterations=5, resume=again).sinogram.numpy(), whole.sinogram.numpy()
    )
    proof = vam.simulate(R, vam.pack(whole, bits=8), target)
    assert proof.independent and isinstance(proof.operator, vam.Projection)
    assert proof.scores.window == vam.simulate(A, vam.pack(whole, bits=8), target).scores.window
    with pytest.raises(BadInput, match="dose of"):
        wider = vam.Target.from_mesh(shapes.build("boat"), height=3.7, pitch=0.4, margin=5, device=A.device)
        B = vam.Projection(wider.grid, A.beam, A.motion, VIAL, A.device)
        vam.optimize(B, wider, iterations=5, resume=whole)


def test_tolerances_are_met_on_rings() -> None:
    target, A = boat(None, 0.5)
    off = vam.Tolerances(absorption=0.1, axis=0.1)
    plan = vam.optimize(vam.RingProjection.of(A), target, iterations=2, tolerances=off)
    assert plan.corners is not None and len(plan.corners.corners) > 2
