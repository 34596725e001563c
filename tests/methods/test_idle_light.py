"""Light in pixels whose rays never meet the part."""

from __future__ import annotations

import numpy as np
import pytest

import vamgpu as vam
from vamgpu.methods.part import idle_light, lit_pixels

GRID = vam.Grid((24, 24, 8), 0.25)
CENTER, RADIUS = (1.2, -0.6), 0.9


def rod() -> np.ndarray:
    """A rod off the axis, through the lower half of the grid."""
    x, y, z = GRID.axes()
    near = np.hypot(x[:, None] - CENTER[0], y[None, :] - CENTER[1]) <= RADIUS
    return (near[:, :, None] & (z < 0)).astype(np.float32)


@pytest.mark.parametrize("dwell", [None, np.linspace(0.5, 1.5, 12)])
def test_pixels_are_lit_where_their_rays_meet_the_part(device, dwell) -> None:
    motion = vam.Turntable(12, dwell)
    A = vam.Projection(GRID, vam.Beam((30, 8), 0.25, spread=0.0), motion, device=device)
    lit = lit_pixels(A, device.upload(rod()))
    found, r = lit.numpy(), A.beam.columns()
    middle = CENTER[1] * np.cos(motion.poses) - CENTER[0] * np.sin(motion.poses)
    away = np.abs(r[None, :] - middle[:, None])
    assert np.isin(found, (0.0, 1.0)).all()
    assert (found[..., :4][away < RADIUS - 0.2] == 1.0).all()
    assert (found[away > RADIUS + 0.4] == 0.0).all() and (found[..., 4:] == 0.0).all()
    rng = np.random.default_rng(0)
    light = rng.random(A.range.shape, np.float32)
    sent = light * motion.times[:, None, None]
    wanted = sent[found == 0.0].sum() / sent.sum()
    assert idle_light(A, device.upload(light), lit) == pytest.approx(wanted, rel=1e-5)
    assert idle_light(A, device.upload(light * found), lit) == pytest.approx(0.0, abs=1e-6)
    assert idle_light(A, device.upload(0.0 * light), lit) == 0.0


def test_plan_and_proof_tell_idle_light_and_what_the_part_absorbs(device) -> None:
    vial = vam.Vial(radius=8.0, wall=0.5, resin_index=1.5, wall_index=1.47, absorption=0.08)
    A = vam.Projection(GRID, vam.Beam((36, 8), 0.25), vam.Turntable(12), vial, device)
    plan = vam.optimize(A, rod(), "recipe", iterations=1)
    lit = lit_pixels(A, device.upload(rod())).numpy()
    light = plan.sinogram.numpy()
    assert 0.05 < plan.idle_light == pytest.approx(light[lit == 0.0].sum() / light.sum(), rel=1e-4)
    proof = vam.simulate(A, vam.pack(plan, quantile=1.0), rod())
    assert proof.idle_light == pytest.approx(plan.idle_light, abs=0.01)
    told = {line.name: line.value for line in proof.lines()}
    assert told["idle light"] == f"{100 * proof.idle_light:.3g} %"
    assert told["light efficiency"] == f"{100 * proof.light_efficiency:.3g} %"
    with pytest.warns(DeprecationWarning, match="light_efficiency"):
        assert proof.part_share == proof.light_efficiency
