"""Light found on rings: as good as that of rays through each voxel, and kept and proven as any other."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import vamgpu as vam
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput
from vamgpu.methods import bound
from vamgpu.targets import shapes

VIAL = vam.Vial(radius=4.2, wall=0.4, resin_index=1.49962, wall_index=1.473, absorption=0.05)


def boat(device: Device | str, pitch: float, height: float = 3.7) -> tuple[vam.Target, vam.Projection]:
    target = vam.Target.from_mesh(shapes.build("boat"), height=height, pitch=pitch, device=device)
    beam = vam.Beam((round(1.5 * target.grid.shape[0]), target.grid.shape[2] + 4), 1.4 * pitch)
    return target, vam.Projection(target.grid, beam, vam.Turntable(180), VIAL, device)


def proven(plan: Any, target: vam.Target) -> float:
    return vam.simulate(plan.operator, vam.pack(plan, bits=8), target).scores.window


@pytest.mark.slow
@pytest.mark.parametrize("method", ["default", "osmo", "recipe"])
def test_light_found_on_rings_proves_as_well(fast_device: Device, is_quick: bool, method: str) -> None:
    """By rays that are traced apart from both. Lights of few splitting steps scatter by 0.005: three are averaged."""
    pitch, less = (0.1, 0.003) if is_quick else (0.3, 0.03)
    target, A = boat(fast_device, pitch)
    windows: dict[bool, list[float]] = {False: [], True: []}
    for evaluations in (60, 90, 120) if method == "default" else (None,):
        plans = [vam.optimize(one, target, method, evaluations=evaluations) for one in (A, vam.RingProjection.of(A))]
        assert plans[0].evaluations == plans[1].evaluations
        for rings, plan in zip(windows, plans, strict=True):
            windows[rings].append(proven(plan, target))
    assert np.mean(windows[True]) >= np.mean(windows[False]) - less


@pytest.mark.parametrize("method", ["default", "osmo", "lbfgs", "bclp", "penalty", "widest"])
def test_every_method_takes_rings(method: str) -> None:
    target, A = boat("numpy", 0.5)
    plan = vam.optimize(vam.RingProjection.of(A), target, method, evaluations=6)
    assert plan.window > -1.0 and float(plan.sinogram.numpy().max()) > 0.0


def test_a_projection_on_rings_is_asked_for_the_dose_of_voxels() -> None:
    target, A = boat("numpy", 0.5)
    rings = vam.RingProjection.of(A).rings
    plan = vam.optimize(vam.SpectralProjection(rings, A.beam, VIAL, "numpy"), target, iterations=2)
    assert isinstance(plan.operator, vam.RingProjection)
    assert (plan.operator.rings, plan.operator.grid) == (rings, target.grid)
    other = vam.PolarGrid(rings.rings, rings.slices + 2, rings.pitch, rings.angles, rings.height)
    with pytest.raises(BadInput, match="same angles and slices"):
        vam.optimize(vam.SpectralProjection(other, A.beam, VIAL, "numpy"), target)


def test_a_bound_goes_on_from_the_plan_of_a_projection_on_rings() -> None:
    """Whose plan is of the voxels that stand for its rings."""
    rings = vam.PolarGrid(16, 2, 0.1, 20, 0.1)
    disc = np.hypot(*np.meshgrid(*2 * [np.arange(n := rings.box.shape[0]) - 0.5 * (n - 1)])) < 5
    target = np.repeat(disc[:, :, None], 2, axis=2).astype(np.float32)
    A = vam.SpectralProjection(rings, vam.Beam((24, 2), 0.1), None, "numpy")
    plan = vam.optimize(A, target, "widest", evaluations=70)
    assert plan.bound is not None
    assert bound(A, target, plan, evaluations=75).value <= plan.bound.value
    with pytest.raises(BadInput, match="another target"):
        bound(A, 1.0 - target, plan)


def test_plans_are_kept_resumed_and_proven(tmp_path: Path) -> None:
    target, A = boat("numpy", 0.4)
    R: Any = vam.RingProjection.of(A)
    half, whole = (vam.optimize(R, target, iterations=n) for n in (3, 5))
    half.save(tmp_path / "half.vam")
    again: Any = vam.load(tmp_path / "half.vam", device="numpy")
    assert isinstance(again.operator, vam.RingProjection) and again.operator.rings == R.rings
    assert "RingProjection" in repr(again.operator)
    np.testing.assert_array_equal(
        vam.optimize(again.operator, again.target, iterations=5, resume=again).sinogram.numpy(), whole.sinogram.numpy()
    )
    proof = vam.simulate(R, vam.pack(whole, bits=8), target)
    assert proof.independent and isinstance(proof.operator, vam.Projection)
    assert proof.scores.window == vam.simulate(A, vam.pack(whole, bits=8), target).scores.window
    with pytest.raises(BadInput, match="dose of"):
        wider = vam.Target.from_mesh(shapes.build("boat"), height=3.7, pitch=0.4, margin=5, device="numpy")
        B = vam.Projection(wider.grid, A.beam, A.motion, VIAL, A.device)
        vam.optimize(B, wider, iterations=5, resume=whole)


def test_tolerances_are_met_on_rings() -> None:
    target, A = boat("numpy", 0.5)
    off = vam.Tolerances(absorption=0.1, axis=0.1)
    plan = vam.optimize(vam.RingProjection.of(A), target, iterations=2, tolerances=off)
    assert plan.corners is not None and len(plan.corners.corners) > 2
