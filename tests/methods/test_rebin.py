"""The vial correction: re-sorted straight light prints what it printed, and the native refracted solve does better."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import vamgpu
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput
from vamgpu.geometry import Beam, Grid, Turntable
from vamgpu.kernels.rebin import rebin_rays
from vamgpu.methods import LBFGS, Plan, optimize, rebin
from vamgpu.operators.projection import Projection

GRID, POSES = Grid((56, 56, 4), 0.18), Turntable(240)
VIAL = vamgpu.Vial(radius=8.0, wall=0.6, resin_index=1.49962, wall_index=1.473, bath_index=1.0, absorption=0.0)


def cross() -> np.ndarray:
    x, y, z = np.meshgrid(*GRID.axes(), indexing="ij")
    return ((((abs(x - 0.5) < 3) & (abs(y) < 1.2)) | ((abs(x + 1) < 0.8) & (abs(y) < 4))) & (abs(z) < 0.3)).astype(
        float
    )


def solve(device: Device | str, vessel: Any = None, method: Any = None) -> Plan:
    columns = int(2 * 8.0 / 0.18) if vessel else 56
    operator = Projection(GRID, Beam((columns, 4), 0.18), POSES, vessel, device=device)
    return optimize(operator, cross(), method or LBFGS(), 20)


@pytest.mark.slow
def test_rebinned_light_gives_the_dose_of_the_straight_plan(fast_device: Device) -> None:
    straight = solve(fast_device)
    native = solve(fast_device, VIAL)
    light = rebin(straight, native.operator)  # type: ignore[arg-type]
    disc = (np.hypot(*np.meshgrid(*GRID.axes()[:2], indexing="ij")) < 4.6)[:, :, None]
    wanted, got = straight.dose().numpy(), native.operator.T(light).numpy()
    assert np.linalg.norm((got - wanted) * disc) <= 0.03 * np.linalg.norm(wanted * disc)

    part = cross() > 0
    inside, outside = got[part].min(), got[~part & disc].max()
    assert inside > outside  # the correction prints the part …
    assert native.window > (inside - outside) / got.max()  # … and solving for the bent rays prints it better
    assert light.numpy().min() >= 0


def test_devices_rebin_alike(fast_device: Device) -> None:
    rng = np.random.default_rng(4)
    parallel = rng.random((12, 9, 7))
    rays = np.stack([rng.uniform(-15, 15, 20), rng.uniform(-2, 10, 20), rng.random(20)], axis=-1)

    def run(device: Device) -> np.ndarray:
        light = device.empty((12, 20, 7))
        device.launch(rebin_rays, parallel=device.upload(parallel), rays=device.table(rays), light=light)
        return light.numpy()

    wanted = run(vamgpu.open_device("numpy"))
    assert np.abs(run(fast_device) - wanted).max() <= 2e-6 * np.abs(wanted).max()


@pytest.mark.slow
def test_bad_pairs_are_refused() -> None:
    straight = solve("numpy", method="fbp")
    with pytest.raises(BadInput, match="an operator with a vessel"):
        rebin(straight, straight.operator)  # type: ignore[arg-type]
    other = Projection(GRID, Beam((88, 4), 0.18), Turntable(100), VIAL, device="numpy")
    with pytest.raises(BadInput, match="same angles"):
        rebin(straight, other)
