"""Contracts of every imperfect beam on every device: exact transposes, agreement, spaces, bad input."""

# pyright: reportCallIssue=false
# (it cannot count the arguments of *a[:3])
from __future__ import annotations

from collections.abc import Callable
from math import inf

import numpy as np
import pytest
from transposes import transpose_gap

import vamgpu as vam
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput, DeviceError, ShapeMismatch
from vamgpu.operators.compose import Composed, Sum
from vamgpu.operators.defocus import Defocus, Defocused
from vamgpu.operators.linear import LinearOperator
from vamgpu.operators.oblique import Oblique
from vamgpu.operators.shifts import Tiles, Wobbled
from vamgpu.operators.wobble import Wobble
from vamgpu.optics.beams import Fan, Misaligned
from vamgpu.optics.occluder import Occluded
from vamgpu.optics.rising_beams import Cone, Inclined

POSES = 3
GLASS = vam.Vial(radius=1.0, wall=0.08, resin_index=1.49962, wall_index=1.473, absorption=0.5)
VAT = vam.Vat(width=2.0, radius=0.9, absorption=0.5)
SQUARE = vam.Vat(width=2.0, absorption=0.5)

Build = Callable[..., LinearOperator]


def project(vessel: object) -> Build:
    return lambda grid, beam, motion, device: vam.Projection(grid, beam, motion, vessel, device)  # type: ignore[arg-type]


def oblique(light: object, wobble: bool = False) -> Build:
    return lambda grid, beam, motion, device: Oblique(
        grid,
        beam,
        motion,
        light,  # type: ignore[arg-type]
        path(motion) if wobble else None,
        device,
    )


def path(motion: vam.Turntable) -> Wobble:
    return Wobble(np.linspace(-0.2, 0.17, motion.angles), np.linspace(0.1, -0.1, motion.angles))


BEAMS: dict[str, Build] = {
    "aimed beside the axis": project(Misaligned(None, offset=0.13, tilt=0.2)),
    "aimed beside a vial": project(Misaligned(GLASS, offset=-0.05, tilt=0.1)),
    "fan": project(Fan(throw=7.0, offset=0.04)),
    "fan into a vial": project(Fan(GLASS, throw=30.0)),
    "rod in a fan": project(Occluded(Fan(VAT, throw=9.0), across=0.2, along=-0.1, radius=0.15, transmittance=0.1)),
    "cone": oblique(Cone(throw=6.0)),
    "cone into a vat": oblique(Cone(VAT, throw=8.0, offset=0.04, tilt=0.1)),
    "inclined": oblique(Inclined(elevation=0.6), True),
    "inclined into a vat": oblique(Inclined(SQUARE, elevation=-0.5)),
    "level in a vial": oblique(GLASS),
    "wobble of the axis alone": oblique(Cone(throw=6.0), True),
    "wobble of vial and axis": lambda *a: Wobbled(vam.Projection(*a[:3], GLASS, a[3]), path(a[2])),
    "out of focus": lambda *a: Defocused(vam.Projection(*a[:3], None, a[3]), Defocus(0.15, 0.3), 0.1),
    "curved focus in a cone": lambda *a: Defocused(
        Oblique(*a[:3], Cone(throw=6.0), path(a[2]), a[3]), Defocus(0.15, 0.4, lambda u: 0.2 - u**2), 0.1
    ),
    "tiles": lambda *a: Tiles(vam.Projection(*a[:3], None, a[3]), a[1].pixels[1] // 2, 1),
    "tiles at parts of rows": lambda *a: Tiles(
        Oblique(*a[:3], Cone(throw=6.0), device=a[3]), a[1].pixels[1] // 2 + 1, 0, [-0.18, 0.03, 0.18]
    ),
    "sum": lambda *a: Sum(
        [vam.Projection(*a[:3], Misaligned(tilt=t), a[3]) for t in (-0.1, 0.0, 0.1)], [0.25, 0.5, 0.25]
    ),
}
every_beam = pytest.mark.parametrize("name", BEAMS)
GEOMETRIES = {
    "as fine": (vam.Grid((4, 3, 4), 0.14), vam.Beam((5, 5), 0.14)),
    "finer beam": (vam.Grid((4, 5, 3), 0.15), vam.Beam((9, 6), 0.09)),
}


def built(name: str, device: Device | str, geometry: str = "as fine") -> LinearOperator:
    return BEAMS[name](*GEOMETRIES[geometry], vam.Turntable(POSES, lit_share=0), device)


CASES = [
    *(pytest.param(name, "as fine") for name in BEAMS),
    *(pytest.param(name, "finer beam") for name in ("fan into a vial", "cone into a vat")),
    *(pytest.param(name, "finer beam", marks=pytest.mark.slow) for name in ("inclined", "out of focus", "tiles")),
]
LARGE = ("fan into a vial", "rod in a fan", "cone", "inclined", "wobble of vial and axis", "out of focus", "tiles")


@pytest.mark.parametrize(("name", "geometry"), CASES)
def test_the_transpose_is_exact_entry_by_entry(device: Device, name: str, geometry: str) -> None:
    A = built(name, device, geometry)
    matrix = A.dense()
    assert np.abs(matrix).max() > 0 and matrix.min() >= 0.0
    assert transpose_gap(A, matrix=matrix) <= 3e-6
    assert A.T.T is A


@every_beam
def test_devices_agree_with_the_reference(device: Device, name: str) -> None:
    A, reference = built(name, device), built(name, "numpy")
    rng = np.random.default_rng(1)
    x, y = rng.random(A.domain.shape), rng.random(A.range.shape)
    for got, wanted in ((A(x), reference(x)), (A.T(y), reference.T(y))):
        assert np.abs(got - wanted).max() <= 1e-5 * np.abs(wanted).max()


@pytest.mark.slow
@pytest.mark.parametrize("name", LARGE)
def test_the_dot_test_holds_at_real_size(fast_device: Device, is_quick: bool, name: str) -> None:
    n = 64 if is_quick else 32
    grid, beam, motion = vam.Grid((n, n, n), 1.6 / n), vam.Beam((n, n), 1.7 / n), vam.Turntable(24, lit_share=0)
    A = BEAMS[name](grid, beam, motion, fast_device)
    assert max(A.dot_test(seed) for seed in range(2)) <= 2e-8


@every_beam
def test_work_on_the_device_crosses_no_bus(fast_device: Device, name: str) -> None:
    A = built(name, fast_device)
    x, y = (fast_device.upload(np.ones(space.shape)) for space in (A.domain, A.range))
    with fast_device.no_transfers():
        A(x)
        A.T(y)


def test_a_composed_operator_names_both_spaces() -> None:
    grid, beam = GEOMETRIES["as fine"]
    A = vam.Projection(grid, beam, vam.Turntable(4), device="numpy")
    B = vam.Projection(vam.Grid((3, 3, 3), 0.1), beam, vam.Turntable(4), device="numpy")
    with pytest.raises(ShapeMismatch, match=r"shape=\(4, 3, 4\).*shape=\(3, 3, 3\)"):
        Composed(A, B.T)
    with pytest.raises(ShapeMismatch, match=r"shape=\(3, 3, 3\).*shape=\(4, 3, 4\)"):
        Sum([A, B])
    with pytest.raises(DeviceError, match="one device"):
        Sum([A, vam.Projection(grid, beam, vam.Turntable(4), device="warp:cpu")])
    assert np.allclose(Composed(A.T, A).dense(), A.dense().T @ A.dense())
    assert Composed(A.T, A).T.T(np.ones(grid.shape)).shape == grid.shape


NUMPY = (vam.Grid((8, 8, 8), 0.1), vam.Beam((8, 8), 0.1), vam.Turntable(4))


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (lambda: Fan(GLASS, throw=0.9), r"throw is 0\.9 mm.*reaches 1 mm"),
        (lambda: Fan(throw=-1.0), "throw"),
        (lambda: vam.Projection(*NUMPY, Fan(throw=0.5), device="numpy"), r"throw is 0\.5 mm.*expected a longer"),
        (lambda: Fan(SQUARE, throw=20.0), "round about the axis"),
        (lambda: Misaligned(Misaligned(offset=0.1)), "one wrapper"),
        (lambda: Misaligned(offset=inf), "finite"),
        (lambda: vam.Projection(*NUMPY, Misaligned(VAT, offset=40.0), device="numpy"), "no column of the beam"),
        (lambda: Cone(GLASS, throw=50.0), "bends"),
        (lambda: Inclined(elevation=1.5), r"85\.94 degrees.*80"),
        (lambda: Occluded(radius=0.0), "radius"),
        (lambda: Occluded(transmittance=1.2), r"0\.\.1"),
        (lambda: vam.Projection(*NUMPY, Cone(throw=9.0), device="numpy"), "Cone"),  # type: ignore[arg-type]
        (lambda: Oblique(*NUMPY, wobble=Wobble(0.5), device="numpy"), r"axis by up to 0\.5 mm.*0\.4 mm"),
        (lambda: Oblique(*NUMPY, wobble=Wobble([0.1, 0.2]), device="numpy"), "has 2 values.*4 angles"),
        (lambda: Wobble(np.nan), "finite"),
        (lambda: Wobbled(vam.Projection(*NUMPY, device="numpy"), Wobble(0.4)), r"axis by up to 0\.4 mm"),
        (lambda: Defocus(-0.03, 3.8), r"fwhm \[mm\] is -0\.03"),
        (lambda: Defocus(0.03, 0.0), "depth_of_focus"),
        (lambda: Defocused(vam.Projection(*NUMPY, device="numpy"), 0.03), "expected Defocus"),  # type: ignore[arg-type]
        (lambda: Tiles(vam.Projection(*NUMPY, device="numpy"), 3, 3), "overlap by 3"),
        (lambda: Tiles(vam.Projection(*NUMPY, device="numpy"), 3, 0, [-0.25, 0.25]), r"gap from z = -0\.1 to 0\.1"),
        (lambda: Tiles(vam.Projection(*NUMPY, device="numpy"), 8, 0, [0.1]), "gap"),
        (lambda: Sum([]), "0 operators"),
    ],
)
def test_bad_input_is_named(wrong: Callable[[], object], message: str) -> None:
    with pytest.raises(BadInput, match=message):
        wrong()
