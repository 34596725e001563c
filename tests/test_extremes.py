"""Numbers, parts and light at the ends of what there is: an answer or a typed error, never NaN, never silence."""

from __future__ import annotations

import warnings
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import vamgpu as vam
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput, EmptyMesh, NoLight, OpticsWarning, PackWarning, SamplingWarning, TargetTooLarge
from vamgpu.methods import BCLP, optimize
from vamgpu.printing.pack import FEW, pack
from vamgpu.printing.simulate import simulate

N, NZ, PITCH = 24, 4, 0.6
GRID, BEAM = vam.Grid((N, N, NZ), PITCH), vam.Beam((N + 8, NZ), PITCH)


def vial(absorption: float) -> vam.Vial:
    """Inner radius 7.5 mm, lit out to 7.35 mm."""
    return vam.Vial(radius=8.5, wall=1.0, resin_index=1.5, wall_index=1.47, bath_index=1.45, absorption=absorption)


def projection(device: Device | str, vessel: Any = None, angles: int = 30, beam: vam.Beam = BEAM) -> vam.Projection:
    return vam.Projection(GRID, beam, vam.Turntable(angles), vessel, device)


def disk(radius: float = 8.0, hole: float = 2.5) -> np.ndarray:
    """A disk with a hole off its middle, radii in voxels."""
    x = np.arange(N) - 0.5 * (N - 1)
    flat = (np.hypot(x[:, None], x) <= radius) & ~(np.hypot(x[:, None] - 2.0, x) < hole)
    return np.repeat(flat[:, :, None], NZ, axis=2).astype(np.float64)


def made(**parts: Any) -> Any:
    """Whatever has light and an operator."""
    return SimpleNamespace(**parts)


def plan_of(operator: vam.Projection, light: np.ndarray) -> Any:
    return made(sinogram=operator.device.upload(light), operator=operator)


def solved(operator: vam.Projection, target: Any) -> tuple[np.ndarray, np.ndarray, Any]:
    """Light, dose and proof of a few steps, all of them finite."""
    plan = optimize(operator, target, iterations=2)
    proof = simulate(operator, pack(plan), target)
    light, dose = plan.sinogram.numpy(), plan.dose().numpy()
    assert np.isfinite(light).all() and light.min() >= 0.0 and light.max() > 0.0
    assert np.isfinite(dose).all() and np.isfinite(plan.window)
    assert np.isfinite([proof.scores.window, proof.scores.iou, proof.scores.threshold, proof.light_efficiency]).all()
    return light, dose, proof


# ---- numbers that float32 cannot hold ---------------------------------------------------------------------------
@pytest.mark.parametrize("value", [1e300, -1e300, 3.5e38])
def test_numbers_beyond_float32_are_refused_everywhere(device: Device, value: float) -> None:
    field = np.zeros((3, 3, 2))
    field[1, 1, 1] = value
    for upload in (device.upload, device.table):
        with pytest.raises(BadInput, match="3.4e.38"):
            upload(field)
    operator = projection(device)
    light, part = np.ones(operator.range.shape), disk()
    light[0, 0, 0], part[5, 5, 1] = value, value
    for act in (
        lambda: operator.T(light),
        lambda: operator(part),
        lambda: pack(plan_of(operator, light)),
        lambda: optimize(operator, part, iterations=1),
        lambda: vam.Target.from_array(part, PITCH),
        lambda: optimize(operator, disk(), BCLP(weight=part), iterations=1),
        lambda: simulate(operator, pack(plan_of(operator, np.ones_like(light))), part),
    ):
        with pytest.raises(BadInput):
            act()


def test_the_greatest_numbers_of_float32_are_taken(device: Device) -> None:
    largest = float(np.finfo(np.float32).max)
    assert device.upload(np.full((2, 2, 2), largest)).numpy().max() == np.float32(largest)
    assert device.upload(np.full((2, 2, 2), 2e-38)).numpy().min() == pytest.approx(2e-38)
    faint = np.full((2, 2, 2), 1e-300)  # tails may vanish; a whole field may not
    faint[0, 0, 0] = 1.0
    assert device.upload(faint).numpy().max() == 1.0
    with pytest.raises(BadInput, match="rounds to 0"):
        device.upload(np.full((2, 2, 2), 1e-300))


def test_whole_numbers_beyond_their_type_are_refused(device: Device) -> None:
    for value, kind in ((2**40, "int32"), (-(2**31) - 1, "int32"), (256, "uint8"), (-1, "uint8")):
        with pytest.raises(BadInput, match=kind):
            device.table(np.array([value]), kind)
    assert device.table(np.array([2**31 - 1]), "int32").numpy()[0] == 2**31 - 1


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_is_refused(device: Device, value: float) -> None:
    operator = projection(device)
    light, part = np.ones(operator.range.shape), disk()
    light[0, 0, 0], part[5, 5, 1] = value, value
    flat = np.ones(BEAM.pixels[::-1])
    flat[0, 0] = value
    for act in (
        lambda: operator.T(light),
        lambda: optimize(operator, part, iterations=1),
        lambda: vam.Target.from_array(part, PITCH),
        lambda: optimize(operator, disk(), BCLP(weight=part), iterations=1),
        lambda: pack(plan_of(operator, light)),
        lambda: pack(plan_of(operator, np.ones_like(light)), flat_field=flat),
        lambda: pack(plan_of(operator, np.ones_like(light)), scale=value),
        lambda: vam.Grid((2, 2, 2), value),
        lambda: vam.Beam((2, 2), value),
        lambda: vial(value),
    ):
        with pytest.raises(BadInput):
            act()


def test_fields_made_on_the_device_are_looked_at_too(device: Device) -> None:
    """What kernels made was never uploaded; 1e30 is beyond 0..1 and beyond what the reductions count as a number."""
    from vamgpu.kernels.update import linear

    operator = projection(device)
    field = device.upload(disk())
    device.launch(linear, a=1e30, x=field, b=0.0, y=field, floor=-1e38, out=field)
    with pytest.raises(BadInput, match="0..1"):
        optimize(operator, field, iterations=1)
    device.launch(linear, a=1e30, x=field, b=0.0, y=field, floor=-1e38, out=field)
    if not np.isfinite(field.numpy()).all():
        with pytest.raises(BadInput, match="NaN or infinity"):
            optimize(operator, field, iterations=1)


@pytest.mark.parametrize("scale", [1e300, 1e-300, 1e31, 1e-31])
def test_a_scale_that_float32_cannot_divide_by_is_refused(device: Device, scale: float) -> None:
    operator = projection(device)
    with pytest.raises(BadInput, match="full-on pixel"):
        pack(plan_of(operator, np.ones(operator.range.shape)), scale=scale)
    if 1e-38 < scale < 1e38:
        with pytest.raises(BadInput, match="full-on pixel"):
            pack(plan_of(operator, np.full(operator.range.shape, scale)))


# ---- absorption -------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("absorption", [10.0, 30.0, 100.0, 1e4])
@pytest.mark.parametrize("kind", ["vial", "vat"])
def test_light_that_is_absorbed_before_the_part_is_told(device: Device, kind: str, absorption: float) -> None:
    operator = projection(device, vial(absorption) if kind == "vial" else vam.Vat(30.0, absorption=absorption))
    dose = operator.T(np.ones(operator.range.shape))
    assert np.isfinite(dose).all() and dose.min() >= 0.0
    assert np.isfinite(operator(disk())).all()
    with pytest.raises(NoLight, match=f"does not reach the part.*absorption is {absorption:g} /mm"):
        optimize(operator, disk(), iterations=4)


@pytest.mark.parametrize("absorption", [10.0, 100.0])
def test_a_part_in_the_light_of_an_absorbing_resin_has_an_answer(device: Device, absorption: float) -> None:
    """A tube whose wall is half a penetration depth thin, close to where light comes in: scaled with absorption."""
    pitch = 0.5 / absorption
    grid, x = vam.Grid((N, N, NZ), pitch), np.arange(N) - 0.5 * (N - 1)
    ring = np.abs(np.hypot(x[:, None], x) - 9.0) < 1.0
    vat = vam.Vat(4.0 * N * pitch, radius=N * pitch, absorption=absorption)
    operator = vam.Projection(grid, vam.Beam((N, NZ), pitch), vam.Turntable(30), vat, device)
    solved(operator, np.repeat(ring[:, :, None], NZ, axis=2).astype(np.float64))


def test_light_that_hardly_reaches_the_part_is_warned_of(device: Device) -> None:
    with pytest.warns(OpticsWarning, match="hardly reaches"):
        optimize(projection(device, vial(1.0)), disk(), iterations=1)
    with warnings.catch_warnings():
        warnings.simplefilter("error", OpticsWarning)
        warnings.simplefilter("ignore", SamplingWarning)
        optimize(projection(device, vial(0.05)), disk(), iterations=1)


# ---- darkness ----------------------------------------------------------------------------------------------------
def test_each_cause_of_darkness_is_told_apart(device: Device) -> None:
    operator = projection(device)
    dark, lit = np.zeros(operator.range.shape), np.ones(operator.range.shape)
    with pytest.raises(EmptyMesh, match="every voxel of the target is 0"):
        optimize(operator, np.zeros(GRID.shape), iterations=1)
    with pytest.raises(NoLight, match="its method found no light"):
        pack(plan_of(operator, dark))
    with pytest.raises(NoLight, match="its method found no light"):
        pack(made(sinogram=device.upload(dark), operator=None))
    solved_by = made(**vars(plan_of(operator, dark)), method=BCLP(), history=(1, 2, 3))
    with pytest.raises(NoLight, match="BCLP found no light in 3 iterations"):
        pack(solved_by)
    with pytest.raises(NoLight, match="reaches from -1 to -1"):
        pack(plan_of(operator, -lit))
    with pytest.raises(NoLight, match="moves all of it off the 32 × 4 pixels"):
        pack(plan_of(operator, lit), shift=(100.0, 0.0))
    absorbed = projection(device, vam.Vat(300.0, absorption=100.0))
    with pytest.raises(NoLight, match="no column lights the grid"):
        pack(plan_of(absorbed, dark))


@pytest.mark.parametrize("timed", [False, True])
def test_frames_that_print_nothing_are_not_judged(device: Device, timed: bool) -> None:
    operator = projection(device)
    times: dict[str, Any] = {"irradiance": 1.0, "critical_dose": 0.1, "absorption": 0.1} if timed else {}
    dark = np.zeros(operator.range.shape)
    beside = dark.copy()
    beside[:, [0, -1]] = 1.0  # meets corners of the grid at most, beyond the cylinder
    with pytest.raises(NoLight, match="every frame is dark"):
        simulate(operator, pack(plan_of(operator, dark), scale=1.0), disk(), **times)
    with pytest.raises(NoLight, match="passes beside it"):
        simulate(operator, pack(plan_of(operator, beside), scale=1.0), disk(), **times)
    with pytest.raises(BadInput, match="no voxel of the target"):
        simulate(operator, pack(plan_of(operator, beside + 1.0)), 0.0 * disk(), **times)


# ---- parts and light of the least and greatest size ----------------------------------------------------------------
def test_a_part_that_fills_the_cylinder_or_the_box(device: Device) -> None:
    operator = projection(device)
    inscribed = disk(radius=0.5 * (N - 1), hole=0.0)
    _, _, proof = solved(operator, vam.Target.from_array(inscribed, PITCH))
    assert proof.scores.iou == 1.0 and proof.scores.out_voxels == 0
    solved(operator, np.ones(GRID.shape))


def test_a_part_that_touches_the_wall(device: Device) -> None:
    """Up to the printable radius there is an answer, beyond it an error, for targets and for bare arrays."""
    n, vessel = 30, vial(0.05)
    grid, x = vam.Grid((n, n, NZ), PITCH), (np.arange(n) - 0.5 * (n - 1)) * PITCH
    operator = vam.Projection(grid, vam.Beam((n + 10, NZ), PITCH), vam.Turntable(30), vessel, device)
    for radius in (vessel.lit_radius - 0.75 * PITCH, grid.inscribed_radius):
        flat = np.hypot(x[:, None], x) <= radius
        part = np.repeat(flat[:, :, None], NZ, axis=2).astype(np.float64)
        for target, error in ((vam.Target.from_array(part, PITCH), TargetTooLarge), (part, NoLight)):
            if radius < vessel.lit_radius:
                solved(operator, target)
            else:
                with pytest.raises(error):
                    optimize(operator, target, iterations=1)


@pytest.mark.parametrize(
    ("shape", "pixels", "angles"),
    [((1, 1, 1), (1, 1), 1), ((1, 1, 1), (4, 1), 4), ((8, 8, 1), (8, 1), 8), ((8, 8, 2), (8, 2), 1)],
)
def test_one_voxel_one_column_one_row_one_angle(
    device: Device, shape: tuple[int, int, int], pixels: tuple[int, int], angles: int
) -> None:
    operator = vam.Projection(vam.Grid(shape, PITCH), vam.Beam(pixels, PITCH), vam.Turntable(angles), None, device)
    solved(operator, np.ones(shape))


def test_a_grid_whose_cylinder_holds_no_voxel_is_told(device: Device) -> None:
    operator = vam.Projection(vam.Grid((1, 8, 2), PITCH), vam.Beam((8, 2), PITCH), vam.Turntable(8), None, device)
    with pytest.raises(BadInput, match="within 0 mm of the axis"):
        solved(operator, np.ones((1, 8, 2)))


def test_light_narrower_or_lower_than_the_part_is_told(device: Device) -> None:
    for pixels in ((2, NZ), (N, 1)):
        with pytest.raises(NoLight, match="a beam of more pixels"):
            optimize(projection(device, beam=vam.Beam(pixels, 0.2 * PITCH)), np.ones(GRID.shape), iterations=1)


# ---- one bit, few angles -------------------------------------------------------------------------------------------
def missed(operator: vam.Projection, wanted: np.ndarray, frames: Any) -> float:
    """Sine of the angle between the dose of frames and that of the light."""
    a, b = (operator.T(light).ravel().astype(np.float64) for light in (wanted, frames.irradiance("numpy").numpy()))
    return float(np.sqrt(max(0.0, 1.0 - (a @ b) ** 2 / ((a @ a) * (b @ b)))))


SHARP = vam.Beam((N, NZ), PITCH, spread=0.0)
"""A lens that blurs nothing, so that single bits count."""


@pytest.mark.parametrize("angles", [1, 3, 6, 12, 48])
def test_diffused_bits_are_never_worse_than_rounded_ones(device: Device, angles: int) -> None:
    operator = projection(device, angles=angles, beam=SHARP)
    plan = optimize(projection("numpy", angles=angles, beam=SHARP), disk(), iterations=6)
    light = np.maximum(plan.sinogram.numpy(), 0.0)
    plan = plan_of(operator, light.astype(np.float32))
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        diffused = pack(plan, bits=1, dither="error-diffusion")
    plain = pack(plan, bits=1, dither="round")
    reference = projection("numpy", angles=angles, beam=SHARP)
    assert missed(reference, light, diffused) <= missed(reference, light, plain) * (1.0 + 1e-5)
    kept = diffused.settings.dither == "error-diffusion"
    assert kept == (not [w for w in told if issubclass(w.category, PackWarning)])
    assert kept or np.array_equal(diffused.levels(), plain.levels())
    if angles in (1, 3):
        assert not kept and f"at {angles} angles error diffusion misses" in str(told[-1].message)
    if angles == 48:
        assert kept


def test_many_angles_are_diffused_without_a_look(device: Device) -> None:
    light = np.abs(np.random.default_rng(0).normal(size=(FEW + 1, N, NZ))).astype(np.float32)
    operator = made(range=vam.Projection(GRID, vam.Beam((N, NZ), PITCH), vam.Turntable(FEW + 1)).range)  # has no T
    plan = made(sinogram=device.upload(light), operator=operator)
    assert pack(plan, bits=1, dither="error-diffusion").settings.dither == "error-diffusion"
