"""The proof of a print in a resin that scatters: other photons, other rings, finer voxels."""

from __future__ import annotations

import numpy as np
import pytest

import vamgpu as vam
from vamgpu.printing.scattered_exposure import ScatteredExposure


def scene(absorption: float) -> vam.ScatteringRings:
    vial = vam.Vial(radius=4.4, wall=0.4, resin_index=1.5, wall_index=1.473, absorption=absorption)
    A = vam.Projection(vam.Grid((24, 24, 8), 0.2), vam.Beam((26, 8), 0.3), vam.Turntable(30), vial)
    return vam.ScatteringRings(A, vam.Scattering(0.6), tolerance=0.06, photons=800_000)


@pytest.mark.parametrize("absorption", [0.08, pytest.param(0.0, marks=pytest.mark.slow)])
def test_other_photons_leave_the_dose_that_the_operator_claims(absorption: float) -> None:
    """Whether the dose is absorbed energy or, without absorption, fluence."""
    S = scene(absorption)
    light = S.device.upload(np.random.default_rng(0).random(S.range.shape).astype(np.float32) ** 4)
    found, outer = ScatteredExposure(S).averaged(light)
    dose, claimed = found.numpy(), S.T(light).numpy()
    lit = np.hypot(*np.meshgrid(*S.grid.axes()[:2], indexing="ij")) < 0.85 * S.grid.inscribed_radius
    error = (dose - claimed)[lit] / claimed[lit].max()
    assert np.sqrt(np.mean(error**2)) < 5e-3
    assert abs(error.mean()) < 2e-3
    direct = S.absorbed_share * vam.Projection(S.grid, S.beam, S.motion, S.attenuated).T(light).numpy()
    assert dose[lit].mean() > 2.0 * direct[lit].mean()  # most light was scattered before
    assert outer is not None and 0.0 < outer.dose < 1.2 * claimed.max()


def test_dose_below_the_voxel_is_that_of_voxels_on_average() -> None:
    S = scene(0.08)
    light = S.device.upload(np.full(S.range.shape, 0.5, np.float32))
    exposure = ScatteredExposure(S)
    dose = exposure.averaged(light)[0].numpy()
    slabs = [(slab.x, slab.z, slab.dose.numpy()) for slab in exposure.fine(light, reach=1.0)]
    z = np.concatenate([each for _, each, _ in slabs])
    x, fine = slabs[0][0], np.concatenate([each for *_, each in slabs], axis=2)
    middle = np.abs(x) < 0.5
    own = dose[np.ix_(np.abs(S.grid.axes()[0]) < 0.5, np.abs(S.grid.axes()[1]) < 0.5)].mean(axis=(0, 1))
    profile = np.interp(S.grid.axes()[2], z, fine[np.ix_(middle, middle)].mean(axis=(0, 1)))
    assert profile == pytest.approx(own, rel=0.01)
