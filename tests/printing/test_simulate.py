"""A simulated print against the dose written out from the equations."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf

import numpy as np
import pytest

from vamgpu import Beam, Grid, Projection, Turntable, Vial
from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput, OpticsWarning, ShapeMismatch
from vamgpu.operators.dose_unit import dose_unit
from vamgpu.printing.frames import Frames
from vamgpu.printing.gray import GrayCurve
from vamgpu.printing.simulate import simulate
from vamgpu.units import mJ_cm3, mW_cm2

GRID = Grid((20, 20, 10), 0.2)
BEAM = Beam((26, 10), 0.25)
TURN = Turntable(16)
VIAL = Vial(radius=3.2, wall=0.2, resin_index=1.45, wall_index=1.47, bath_index=1.3, absorption=0.08)


@dataclass
class Shown:
    """Frames that are nothing but their light."""

    light: np.ndarray
    scale: float

    def irradiance(self, device: Device) -> DeviceArray:
        return device.upload(self.light)


def ball(shape: tuple[int, int, int]) -> np.ndarray:
    axes = np.meshgrid(*(np.linspace(-1, 1, n) for n in shape), indexing="ij")
    return np.clip((0.55 - np.sqrt(sum(a**2 for a in axes))) * 6 + 0.5, 0, 1)


def shown(A: Projection, scale: float = 2.0) -> Shown:
    light = np.maximum(np.asarray(A(ball(A.grid.shape))), 0)
    return Shown(scale * light / light.max(), scale)


def test_calibrated_dose_follows_the_equation(device: Device) -> None:
    A = Projection(GRID, BEAM, TURN, VIAL, device)
    light = np.random.default_rng(0).random(A.range.shape)
    got = dose_unit(A, dwell=0.75, unit=3.0) * np.asarray(A.T(light), float)
    matrix = Projection(GRID, BEAM, TURN, VIAL, "numpy")
    wanted = np.asarray(matrix.T(3.0 * light)) * 0.25**2 * 0.75 / 0.2**3
    assert np.abs(got - wanted).max() <= 1e-5 * wanted.max()


def test_energy_absorbed_is_the_energy_sent_times_the_absorbed_share() -> None:
    """Of every ray of a sharp beam in a vial of one index 1 − exp(−αL) is absorbed: to 1e-3 on 121 voxels."""
    grid, beam = Grid((121, 121, 3), 0.05), Beam((121, 3), 0.05, spread=0.0)
    vial = Vial(radius=2.8, wall=0.0, resin_index=1.33, wall_index=1.33, bath_index=1.33, absorption=0.2)
    A = Projection(grid, beam, Turntable(37), vial, "numpy")
    u = beam.columns()
    lit = np.maximum(1 - (u / 2.2) ** 2, 0)
    light = np.broadcast_to(5.0 * lit[None, :, None], A.range.shape)
    dose = dose_unit(A, dwell=2.0) * np.asarray(A.T(light), float)
    share = -np.expm1(-0.2 * 2 * np.sqrt(np.maximum(2.8**2 - u**2, 0)))
    absorbed = 37 * 3 * np.sum(5.0 * lit * share) * beam.pixel_area * 2.0
    assert dose.sum() * grid.voxel_volume == pytest.approx(absorbed, rel=1e-3)


def test_the_predicted_exposure_brings_the_threshold_to_the_critical_dose(device: Device) -> None:
    A = Projection(GRID, BEAM, TURN, VIAL, device)
    frames, target = shown(A), ball(GRID.shape)
    proof = simulate(A, frames, target, irradiance=6.0, critical_dose=1.5)
    assert proof.exposure is not None and proof.seconds is not None
    dwell = proof.seconds / TURN.angles
    dose = proof.dose.numpy().astype(float) * dose_unit(A, dwell, unit=6.0 / frames.scale)
    printed = proof.printed()
    assert dose[printed].min() >= 1.5 * (1 - 1e-5)
    judged = np.broadcast_to(GRID.cylinder()[..., None], dose.shape)
    assert dose[judged & ~printed].max() <= 1.5 * (1 + 1e-5)
    inside = judged & (target >= 0.5)
    assert dose[inside].min() * proof.exposure.complete / proof.seconds == pytest.approx(1.5, rel=1e-5)
    assert dose[judged & (target < 0.5)].max() * proof.exposure.overcure_onset / proof.seconds == pytest.approx(
        1.5, rel=1e-5
    )
    sent = frames.light.sum() / frames.scale * 6.0 * BEAM.pixel_area * dwell
    assert proof.exposure.energy == pytest.approx(sent, rel=1e-5)
    assert proof.light_efficiency == pytest.approx(dose[inside].sum() * GRID.voxel_volume / sent, rel=1e-5)
    assert proof.mean_brightness == pytest.approx(frames.light.mean() / frames.scale, rel=1e-5)


def test_irradiance_and_dose_are_told_as_laboratories_write_them() -> None:
    A = Projection(GRID, BEAM, TURN, VIAL)
    frames, target = shown(A), ball(GRID.shape)
    proof = simulate(A, frames, target, irradiance=65 * mW_cm2, critical_dose=100 * mJ_cm3)
    assert proof.exposure is not None
    assert (proof.exposure.irradiance, proof.exposure.critical_dose) == pytest.approx((0.65, 0.1))
    meaning = next(line.meaning for line in proof.lines() if line.name == "exposure")
    assert meaning == "until resin at the threshold is solid, at 65 mW/cm² full-on and 100 mJ/cm³"
    with pytest.raises(BadInput, match=r"irradiance is -65 \* mW_cm2; expected .* > 0 times vamgpu\.units\.mW_cm2"):
        simulate(A, frames, target, irradiance=-65 * mW_cm2, critical_dose=100 * mJ_cm3)
    dark = replace(proof, exposure=replace(proof.exposure, overcure_onset=inf))
    assert next(line.value for line in dark.lines() if line.name == "first excess") == "never"
    said = simulate(A, frames, target, irradiance="65 mW/cm2", critical_dose="0.1 mJ/mm³")
    assert said.exposure == proof.exposure
    with pytest.warns(
        OpticsWarning, match=r"irradiance is 65 without a unit: that is 65 mW/mm², or 6500 mW/cm2; if 65"
    ):
        simulate(A, frames, target, irradiance=65, critical_dose=0.1)
    with pytest.warns(OpticsWarning, match=r"dose is 100 .*100000 mJ/cm3; if .* write 100 \* vamgpu\.units\.mJ_cm3"):
        simulate(A, frames, target, irradiance=0.65, critical_dose=100)
    with pytest.raises(BadInput, match=r"critical_dose: got '100'; expected a dose in mJ/cm3"):
        simulate(A, frames, target, irradiance=65 * mW_cm2, critical_dose="100")


def test_scores_do_not_change_with_the_scale_of_the_light(device: Device) -> None:
    A = Projection(GRID, BEAM, TURN, VIAL, device)
    target = ball(GRID.shape)
    dim, bright = (simulate(A, shown(A, scale), target, irradiance=6, critical_dose=2) for scale in (0.5, 64.0))
    assert bright.scores.window == pytest.approx(dim.scores.window, abs=1e-5)
    assert bright.scores.iou == pytest.approx(dim.scores.iou, abs=1e-5)
    assert bright.seconds == pytest.approx(dim.seconds, rel=1e-4)
    assert dim.seconds is not None
    within = 0.99 * 86_400.0 / dim.seconds  # times as much dose, for which a day does
    assert simulate(A, shown(A, 0.5), target, irradiance=6 / within, critical_dose=2).seconds is not None
    with pytest.raises(BadInput, match=r"would take .* s, 1\.0\d* days, at .*expected at most a day: check"):
        simulate(A, shown(A, 0.5), target, irradiance=6 * 0.97 / within, critical_dose=2)


def test_one_pixel_changes_the_dose(device: Device) -> None:
    A = Projection(GRID, BEAM, TURN, VIAL, device)
    frames, target = shown(A), device.upload(ball(GRID.shape))
    before = simulate(A, frames, target).dose.numpy()
    frames.light[3, 13, 5] += 0.5
    change = simulate(A, frames, target).dose.numpy() - before
    assert change[:, :, 5].max() > 0
    assert change.min() >= -1e-6 * before.max()


@pytest.mark.slow
@pytest.mark.parametrize("bits", [1, 8])
def test_one_bit_of_the_frames_changes_the_dose_at_its_height(device: Device, bits: int) -> None:
    A = Projection(GRID, BEAM, TURN, VIAL, device)
    rng = np.random.default_rng(5)
    width = 26 if bits == 8 else 4
    images = rng.integers(0, 256, (16, 10, width), dtype=np.uint8)
    target = device.upload(ball(GRID.shape))
    gray = GrayCurve.linear(black=0.02)
    flipped = images.copy()
    flipped[5, 3, 13 if bits == 8 else 1] ^= 64
    before, after = (
        simulate(A, Frames.from_bytes(i, device, bits=bits, gray=gray, scale=1.5, columns=26), target)
        for i in (images, flipped)
    )
    change = np.abs(after.dose.numpy() - before.dose.numpy())
    height = (10 - 1 - 3 - 4.5) * BEAM.pitch  # of picture row 3
    near = np.abs(GRID.axes()[2] - height) < (0.5 + 4.5 * 0.5) * BEAM.pitch + 0.5 * GRID.pitch  # lit box, spread, slice
    assert change[:, :, near].max() > 1e-4 * before.scores.peak
    assert change[:, :, ~near].max() == 0.0


def test_straight_light_needs_to_be_told_how_much_is_absorbed() -> None:
    beam = Beam((20, 10), 0.2)
    A = Projection(GRID, beam, TURN)
    frames, target = shown(A), ball(GRID.shape)
    assert simulate(A, frames, target).seconds is None
    with pytest.raises(BadInput, match="give absorption="):
        simulate(A, frames, target, irradiance=6, critical_dose=2)
    thin = simulate(A, frames, target, irradiance=6, critical_dose=2, absorption=0.1)
    thick = simulate(A, frames, target, irradiance=6, critical_dose=2, absorption=0.2)
    assert thin.seconds == pytest.approx(2 * (thick.seconds or 0))


def test_wrong_input_is_refused() -> None:
    A = Projection(GRID, BEAM, TURN, VIAL, "cpu")
    frames, target = shown(A), ball(GRID.shape)
    with pytest.raises(BadInput, match="irradiance without critical_dose"):
        simulate(A, frames, target, irradiance=6)
    with pytest.raises(BadInput, match="leave it out"):
        simulate(A, frames, target, irradiance=6, critical_dose=2, absorption=0.1, coarse=True)
    with pytest.raises(BadInput, match="critical_dose"):
        simulate(A, frames, target, irradiance=6, critical_dose=-1, coarse=True)
    with pytest.raises(BadInput, match="threshold is nan"):
        simulate(A, frames, target, threshold=float("nan"))
    with pytest.raises(ShapeMismatch, match="target"):
        simulate(A, frames, target[1:])
    with pytest.raises(ShapeMismatch, match="light"):
        simulate(A, Shown(frames.light[1:], 1.0), target)
    with pytest.raises(BadInput, match="every frame is dark"):
        simulate(A, Shown(0 * frames.light, 1.0), target, irradiance=6, critical_dose=2)
