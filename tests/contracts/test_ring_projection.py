"""Projection of a box that is computed on rings, against the one by rays through each voxel."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import vamgpu as vam
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput, OutOfMemory
from vamgpu.operators.defocus import direct
from vamgpu.operators.ring_projection import prefers_rings, unsupported_reason
from vamgpu.operators.ring_splines import NEXT, OWN

VIAL = vam.Vial(radius=1.0, wall=0.08, resin_index=1.49962, wall_index=1.473, bath_index=1.0, absorption=0.5)
GRID, TURN = vam.Grid((20, 22, 4), 0.05), vam.Turntable(24)
GEOMETRIES: dict[str, Any] = {
    "straight": (GRID, vam.Beam((22, 6), 0.05), TURN, None),
    "refracted and absorbed": (GRID, vam.Beam((25, 5), 0.06), TURN, VIAL),
    "light that nothing mirrors": (GRID, vam.Beam((25, 5), 0.06), TURN, vam.Misaligned(VIAL, offset=0.07)),
}
every_geometry = pytest.mark.parametrize("geometry", GEOMETRIES)


@every_geometry
def test_the_transpose_is_exact(device: Device, geometry: str) -> None:
    assert vam.RingProjection(*GEOMETRIES[geometry], device=device).dot_test() <= 1e-7


@every_geometry
def test_devices_agree(device: Device, geometry: str) -> None:
    here, reference = (vam.RingProjection(*GEOMETRIES[geometry], device=place) for place in (device, "numpy"))
    light = np.random.default_rng(0).random(here.range.shape)
    wanted = np.asarray(reference.T(light))
    assert np.abs(np.asarray(here.T(light)) - wanted).max() <= 3e-6 * wanted.max()


@pytest.mark.parametrize("vessel", [None, VIAL], ids=["straight", "in a vial"])
def test_dose_and_projection_are_those_of_rays(vessel: Any) -> None:
    grid, beam, turn = vam.Grid((40, 40, 2), 0.025), vam.Beam((44, 6), 0.025 if vessel is None else 0.033), 48
    A = vam.Projection(grid, beam, vam.Turntable(turn), vessel, "numpy")
    R = vam.RingProjection.of(A)
    assert R.direct is A and R.grid == grid
    near, rng = grid.cylinder()[:, :, None], np.random.default_rng(0)
    light, volume = rng.random(A.range.shape), rng.random(grid.shape) * near
    for got, wanted in (((R.T(light) * near), A.T(light) * near), (R(volume), A(volume))):
        off = np.abs(np.asarray(got) - np.asarray(wanted)) / np.asarray(wanted).max()
        assert off.max() <= 0.01 and np.sqrt((off**2).mean()) <= 0.001


@pytest.mark.parametrize("ratio", [0.5, 0.75, 1.0])
def test_rings_are_as_narrow_as_light_asks_for(ratio: float) -> None:
    """Sharp columns of 0.33 to 0.67 voxels in the resin, whose light is finer than voxels are."""
    grid = vam.Grid((40, 40, 2), 0.025)
    beam = vam.Beam((2 * round(33 / ratio), 2), 0.025 * ratio, spread=0.0)
    A = vam.Projection(grid, beam, vam.Turntable(48), VIAL, "numpy")
    light = np.random.default_rng(0).random(A.range.shape) ** 4
    wanted, inner = np.asarray(A.T(light)), np.hypot(*np.meshgrid(*grid.axes()[:2])) < 0.44
    off = (np.asarray(vam.RingProjection.of(A).T(light)) - wanted)[inner] / wanted.max()
    assert np.sqrt((off**2).mean()) <= 0.0028


@pytest.mark.parametrize("radius", [0.77, 0.75, 0.6], ids=["a voxel beyond the grid", "at its rim", "inside it"])
def test_light_may_end_near_the_rim(radius: float) -> None:
    vial, grid, beam = replace(VIAL, radius=radius), vam.Grid((40, 40, 2), 0.025), vam.Beam((44, 6), 0.033)
    A = vam.Projection(grid, beam, vam.Turntable(48), vial, "numpy")
    light, near = np.random.default_rng(0).random(A.range.shape), grid.cylinder()
    wanted = np.asarray(A.T(light))
    off = np.abs(np.asarray(vam.RingProjection.of(A).T(light)) - wanted)[near] / wanted.max()
    inner = np.hypot(*np.meshgrid(*grid.axes()[:2]))[near] < vial.lit_radius - 2 * grid.pitch
    assert off[inner].max() <= 0.005 and off.max() <= 0.06 and np.sqrt((off**2).mean()) <= 0.006


@pytest.mark.parametrize("rows", [22, 27], ids=["rows as slices", "rows resampled"])
def test_strips_of_slices_give_the_same(device: Device, monkeypatch: Any, rows: int) -> None:
    geometry = (vam.Grid((12, 13, 22), 0.05), vam.Beam((18, rows), 0.05, spread=0.0), vam.Turntable(9), None, device)
    whole = vam.RingProjection(*geometry)
    monkeypatch.setattr("vamgpu.operators.ring_projection.AT_ONCE", {False: 1, True: 1})
    monkeypatch.setattr("vamgpu.operators.ring_projection.THICK", 8)
    strips = vam.RingProjection(*geometry)
    assert list(strips._strips) == [0, 8, 16] and strips._spectral.grid.slices == 8 and strips.rings.slices == 22
    rng = np.random.default_rng(0)
    volume, light = rng.random(whole.domain.shape), rng.random(whole.range.shape)
    least = 1e-14 if device.name == "numpy" else 0.0  # its sums change their order with the slices
    for _ in range(2):  # what is left in the strips changes nothing
        for got, wanted in ((strips(volume), whole(volume)), (strips.T(light), whole.T(light))):
            assert np.abs(np.asarray(got) - np.asarray(wanted)).max() <= least * np.asarray(wanted).max()


@pytest.mark.parametrize("vessel", [pytest.param(None, marks=pytest.mark.slow), VIAL], ids=["straight", "in a vial"])
@pytest.mark.slow
def test_light_out_of_focus_is_that_of_rays(vessel: Any) -> None:
    grid, beam = vam.Grid((40, 40, 4), 0.025), vam.Beam((44, 6), 0.025 if vessel is None else 0.033)
    R, lens = vam.RingProjection(grid, beam, vam.Turntable(48), vessel, "numpy"), vam.Defocus(0.06, 0.4, focus=0.1)
    A, sharp = vam.Defocused(R, lens), R.T
    wanted = direct(A)
    assert isinstance(wanted.operator, vam.Projection) and direct(wanted) is wanted and len(A.nodes) > 2
    assert A.dot_test() <= 1e-7
    near, light = grid.cylinder()[:, :, None], np.random.default_rng(0).random(A.range.shape)
    dose, rays = np.asarray(A.T(light)) * near, np.asarray(wanted.T(light)) * near
    off = np.abs(dose - rays) / rays.max()
    assert off.max() <= 0.02 and np.sqrt((off**2).mean()) <= 0.003
    assert np.sqrt(np.mean((np.asarray(sharp(light)) * near - rays) ** 2)) > 0.02 * rays.max()


def test_what_is_linear_is_met_everywhere_and_at_the_axis() -> None:
    R = vam.RingProjection(vam.Grid((12, 12, 2), 0.1), vam.Beam((12, 2), 0.1), vam.Turntable(24), device="numpy")
    rho, phi = R.rings.places
    samples = np.concatenate([np.full(b.rings * b.samples, b.samples * 24) for b in R.rings.bands])
    coefficients = rho * np.cos(phi) / (OWN + 2.0 * NEXT * np.cos(2.0 * np.pi / samples))  # of a wave, along the angle
    across, along = R.grid.axes()[:2]
    entries, first = (R._to_voxels[name].numpy() for name in ("entries", "first"))
    taken = np.add.reduceat(np.append(entries[:, 1] * coefficients.ravel()[entries[:, 0].astype(int)], 0.0), first)
    blocks = (first.size - 1) // 144
    found = np.where(np.diff(first) > 0, taken[:-1], 0.0).reshape(12, blocks, 12).sum(axis=1)
    near = R.grid.cylinder()
    assert np.abs(found - across[:, None] + 0.0 * along)[near].max() <= 1e-4 * 0.1


def test_light_that_lies_higher_lights_higher_slices() -> None:
    grid, beam = vam.Grid((20, 20, 12), 0.05), vam.Beam((22, 16), 0.05)
    R = vam.RingProjection.of(vam.Projection(grid, beam, TURN, VIAL, "numpy"), 0.75)
    light = np.zeros(R.range.shape)
    light[:, :, 5:9] = np.random.default_rng(0).random((1, 22, 4))
    dose, higher = (np.asarray(each.T(light)) for each in (R, R.raised(2 * beam.pitch)))
    assert R.raised(0.013).dot_test() <= 1e-7 and dose.max() > 0
    np.testing.assert_allclose(higher[:, :, 2:], dose[:, :, :-2], atol=1e-6 * dose.max())
    by = [float((np.asarray(R.raised(h).T(light)).sum(axis=(0, 1)) @ grid.axes()[2]) / dose.sum()) for h in (0, 0.013)]
    assert by[1] - by[0] == pytest.approx(0.013, rel=0.01)


def test_narrower_rings_come_nearer() -> None:
    grid, beam, turn = vam.Grid((40, 40, 2), 0.025), vam.Beam((44, 6), 0.025), vam.Turntable(48)
    A = vam.Projection(grid, beam, turn, None, "numpy")
    light = np.random.default_rng(0).random(A.range.shape)
    wanted, near = np.asarray(A.T(light)), grid.cylinder()
    off = []
    for width in (1.0, 0.75, 0.5):
        rings = vam.PolarGrid(8 * round(24 / width / 8 + 0.49), 2, width * grid.pitch, 48, grid.pitch)
        dose = np.asarray(vam.RingProjection(grid, beam, turn, None, "numpy", rings=rings).T(light))
        off.append(float(np.sqrt((((dose - wanted) / wanted.max())[near] ** 2).mean())))
    assert off[0] > 1.3 * off[1] > 1.3**2 * off[2]


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"motion": vam.Turntable.arc(24, np.pi)}, "even over a full turn"),
        ({"motion": vam.Turntable(24, dwell=np.arange(24) + 1.0)}, "lit equally"),
        ({"motion": vam.Turntable(1)}, "two or more"),
        ({"grid": vam.Grid((20, 20, 3), 0.05)}, "an even number"),
        ({"rings": vam.PolarGrid(16, 4, 0.05, 12)}, "the same angles"),
        ({"grid": 3}, "Grid"),
    ],
)
def test_what_rings_do_not_take_is_refused(given: dict[str, Any], said: str) -> None:
    with pytest.raises(BadInput, match=said):
        vam.RingProjection(**{"grid": GRID, "beam": vam.Beam((22, 6), 0.05), "motion": TURN, **given})


def test_why_an_operator_is_left_as_it_is() -> None:
    beam = vam.Beam((20, 4), 0.05, spread=0.0)
    A = vam.Projection(GRID, beam, vam.Turntable([0.0, 1.0, 2.5]), device="numpy")
    assert "even" in unsupported_reason(A) and "Sum" in unsupported_reason(A + A)
    with pytest.raises(BadInput, match="even"):
        vam.RingProjection.of(A)


@pytest.mark.parametrize(
    ("rings", "said"),
    [
        (0.7, "expected a PolarGrid"),
        (vam.PolarGrid(24, 4, 0.04, 24), "pass height=0.05"),
        (vam.PolarGrid(8, 4, 0.04, 24, 0.05), "expected 15 or more"),
        (vam.PolarGrid(24, 4, 0.04, 20, 0.05), "same angles"),
    ],
)
def test_rings_that_do_not_fit_are_refused(rings: Any, said: str) -> None:
    with pytest.raises(BadInput, match=said):
        vam.RingProjection(GRID, vam.Beam((22, 6), 0.05), TURN, device="numpy", rings=rings)


def test_widths_and_heights_that_make_no_sense_are_refused() -> None:
    A = vam.Projection(GRID, vam.Beam((22, 6), 0.05), TURN, None, "numpy")
    for width in (0.0, 1e-3, 4.0, "wide"):
        with pytest.raises(BadInput, match="width"):
            vam.RingProjection.of(A, width)  # pyright: ignore[reportArgumentType]
    R = vam.RingProjection.of(A)
    with pytest.raises(BadInput, match="height"):
        R.raised(float("nan"))
    with pytest.raises(BadInput, match="on rings already"):
        vam.RingProjection.of(R)  # pyright: ignore[reportArgumentType]


def test_light_sought_on_too_few_rings_is_sought_on_enough() -> None:
    few = vam.SpectralProjection(vam.PolarGrid(8, 2, 0.1, 12), vam.Beam((20, 2), 0.1), None, "numpy")
    part = (np.hypot(*np.indices(few.grid.box.shape[:2]) - 7.5) < 4.0).astype(np.float32)
    plan: Any = vam.optimize(few, np.repeat(part[:, :, None], 2, axis=2), "osmo", iterations=1, progress=False)
    assert plan.operator.rings.rings >= 10 > few.grid.rings


@pytest.mark.parametrize(
    ("algorithm", "prefers", "kind"),
    [
        ("auto", True, vam.RingProjection),
        ("auto", False, vam.Projection),
        ("rays", True, vam.Projection),
        ("rings", False, vam.RingProjection),
    ],
)
def test_projector_chooses_the_algorithm(
    monkeypatch: pytest.MonkeyPatch, algorithm: Any, prefers: bool, kind: type[Any]
) -> None:
    monkeypatch.setattr("vamgpu.operators.projector.prefers_rings", lambda _: prefers)
    A = vam.projector(*GEOMETRIES["refracted and absorbed"], device="numpy", algorithm=algorithm)
    assert type(A) is kind
    assert (A.grid, A.beam, A.motion, A.vessel) == tuple(GEOMETRIES["refracted and absorbed"])


def test_projector_without_memory_for_rings(monkeypatch: pytest.MonkeyPatch) -> None:
    def full(_: Any, shape: tuple[int, ...]) -> Any:
        raise OutOfMemory(f"no room for {shape}")

    monkeypatch.setattr("vamgpu.backend.device.Device.reserve", full)
    monkeypatch.setattr("vamgpu.operators.projector.prefers_rings", lambda _: True)
    assert isinstance(vam.projector(*GEOMETRIES["refracted and absorbed"], device="numpy"), vam.Projection)
    with pytest.raises(OutOfMemory, match="no room"):
        vam.projector(*GEOMETRIES["refracted and absorbed"], device="numpy", algorithm="rings")


def test_projector_refuses_what_no_algorithm_computes() -> None:
    beam = vam.Beam((22, 6), 0.05)
    with pytest.raises(BadInput, match="algorithm is 'fast'; expected one of auto, rays, rings"):
        vam.projector(GRID, beam, TURN, algorithm="fast")  # type: ignore[arg-type]
    with pytest.raises(BadInput, match=r"(?s)rings do not support.*even over a full turn"):
        vam.projector(GRID, beam, vam.Turntable([0.0, 0.1, 0.3]), device="numpy", algorithm="rings")
    assert not prefers_rings(vam.Projection(GRID, beam, vam.Turntable([0.0, 0.1, 0.3]), device="numpy"))
