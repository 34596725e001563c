"""Contracts of every operator on every device: exact transpose, agreement with the reference, spaces, doors."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from transposes import transpose_gap

import vamgpu as vam
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput, DeviceError, KernelError, ShapeMismatch, TransferForbidden

GLASS: dict[str, Any] = {"wall": 0.08, "resin_index": 1.49962, "wall_index": 1.473}


def glass_vial(absorption: float = 0.5) -> vam.Vial:
    return vam.Vial(radius=1.0, bath_index=1.0, absorption=absorption, **GLASS)


GEOMETRIES = {
    "straight": (vam.Grid((9, 7, 3), 0.1), vam.Beam((11, 3), 0.1), None),
    "tiny": (vam.Grid((3, 4, 2), 0.1), vam.Beam((5, 2), 0.1), None),
    "one voxel, one column": (vam.Grid((1, 1, 1), 0.1), vam.Beam((1, 1), 0.1), None),
    "one slice": (vam.Grid((8, 8, 1), 0.1), vam.Beam((8, 1), 0.1), None),
    "more rows than slices": (vam.Grid((5, 6, 4), 0.1), vam.Beam((5, 6), 0.1), None),
    "fewer rows than slices": (vam.Grid((5, 6, 5), 0.1), vam.Beam((5, 2), 0.1), None),
    "finer columns": (vam.Grid((5, 6, 3), 0.1), vam.Beam((9, 5), 0.07), None),
    "coarser columns": (vam.Grid((6, 7, 3), 0.1), vam.Beam((5, 3), 0.15), None),
    "refracted": (vam.Grid((9, 8, 3), 0.125), vam.Beam((10, 4), 0.19), glass_vial(0.0)),
    "refracted and absorbed": (vam.Grid((9, 10, 2), 0.125), vam.Beam((13, 3), 0.15), glass_vial()),
    "vat": (vam.Grid((9, 9, 2), 0.1), vam.Beam((9, 2), 0.1), vam.Vat(width=1.0, absorption=0.8)),
}

every_geometry = pytest.mark.parametrize("geometry", GEOMETRIES)


def operator(geometry: str, device: Device | str, angles: int = 7) -> vam.Projection:
    grid, beam, vessel = GEOMETRIES[geometry]
    return vam.Projection(grid, beam, vam.Turntable(angles), vessel, device=device)


@every_geometry
def test_the_transpose_is_exact_entry_by_entry(device: Device, geometry: str) -> None:
    A = operator(geometry, device)
    assert transpose_gap(A, most=200) <= 3e-6


@every_geometry
def test_devices_agree_with_the_reference(device: Device, geometry: str) -> None:
    rng = np.random.default_rng(1)
    A, reference = operator(geometry, device), operator(geometry, "numpy")
    x, y = rng.random(A.domain.shape), rng.random(A.range.shape)
    for got, wanted in ((A(x), reference(x)), (A.T(y), reference.T(y))):
        assert np.abs(got - wanted).max() <= 1e-5 * np.abs(wanted).max()


@pytest.mark.slow
@pytest.mark.parametrize("vessel", [None, "vial"])
def test_the_dot_test_holds_at_real_size(fast_device: Device, is_quick: bool, vessel: str | None) -> None:
    n, angles = (128, 180) if is_quick else (40, 60)
    vial = vam.Vial(radius=12.4, wall=1.0, resin_index=1.49962, wall_index=1.473, bath_index=1.0, absorption=0.05)
    pitch = 16.64 / n
    grid, beam = vam.Grid((n, n, n), pitch), vam.Beam((n, n), pitch if vessel is None else 1.5 * pitch)
    A = vam.Projection(grid, beam, vam.Turntable(angles), vial if vessel else None, device=fast_device)
    assert max(A.dot_test(seed) for seed in range(2)) <= 2e-8


@pytest.mark.slow
@pytest.mark.parametrize("vessel", [None, "vial"])
def test_devices_agree_on_a_target_at_real_size(fast_device: Device, is_quick: bool, vessel: str | None) -> None:
    n, angles = (96, 30) if is_quick else (48, 20)
    x, y, z = np.meshgrid(*(np.linspace(-1, 1, n),) * 3, indexing="ij")
    target = ((x / 0.5) ** 2 + (y / 0.3) ** 2 + (z / 0.8) ** 2 < 1).astype(np.float32)
    vial = vam.Vial(radius=12.4, wall=1.0, resin_index=1.49962, wall_index=1.473, bath_index=1.0, absorption=0.05)
    grid, beam, motion = vam.Grid((n, n, n), 15.36 / n), vam.Beam((n, n), 15.36 / n), vam.Turntable(angles)
    geometry = (grid, beam, motion, vial if vessel else None)
    A, reference = vam.Projection(*geometry, device=fast_device), vam.Projection(*geometry, device="numpy")
    image = reference(target)
    assert np.abs(A(target) - image).max() <= 1e-5 * image.max()
    dose = reference.T(image)
    assert np.abs(A.T(image) - dose).max() <= 1e-5 * dose.max()


def test_spaces_and_identities(device: Device) -> None:
    A = operator("straight", device)
    assert A.T.T is A
    assert A.domain.shape == (9, 7, 3) and A.range.shape == (7, 11, 3)
    assert np.allclose(A.motion.poses, 2 * np.pi * np.arange(7) / 7)
    assert A.T.domain is A.range and A.T.range is A.domain


def test_numpy_in_numpy_out_device_in_device_out(device: Device) -> None:
    A = operator("straight", device)
    x = np.ones(A.domain.shape, np.float32)
    assert isinstance(A(x), np.ndarray)
    kept = A(device.upload(x))
    assert kept.device is device and np.array_equal(kept.numpy(), A(x))
    out = device.empty(A.range.shape)
    assert A(device.upload(x), out=out) is out


def test_work_on_the_device_crosses_no_bus(device: Device) -> None:
    A = operator("refracted and absorbed", device)
    x = device.upload(np.ones(A.domain.shape))
    with device.no_transfers():
        y = A(x)
        A.T(y)
    big = device.empty((16, 16, 16))
    with device.no_transfers(), pytest.raises(TransferForbidden, match="no_transfers"):
        big.numpy()


def test_bad_input_is_named(device: Device) -> None:
    A = operator("straight", device)
    with pytest.raises(ShapeMismatch, match=r"\(9, 7, 3\)"):
        A(np.zeros((3, 3, 3)))
    with pytest.raises(BadInput, match="NaN"):
        A(np.full(A.domain.shape, np.nan))
    with pytest.raises(BadInput, match="real numbers"):
        A(np.full(A.domain.shape, 1j))
    with pytest.raises(KernelError, match="takes"):
        from vamgpu.kernels.update import linear

        device.launch(linear, x=device.empty((2, 2, 2)))
    with pytest.raises(DeviceError, match="available"):
        vam.open_device("opencl:nowhere:0")
    other = vam.open_device("warp:cpu" if device.name != "warp:cpu" else "numpy")
    with pytest.raises(DeviceError, match="is on"):
        A(other.upload(np.zeros(A.domain.shape)))


@pytest.mark.parametrize(
    ("kind", "arguments"),
    [
        (vam.Grid, ((8, 8, 8), float("nan"))),
        (vam.Grid, ((8, 8, 8), -0.1)),
        (vam.Grid, ((8, 8), 0.1)),
        (vam.Grid, ((8, 8, 8), "0.1 kg")),
        (vam.Grid, ((8, 8, 0), 0.1)),
        (vam.Beam, ((8, 8.5), 0.1)),
        (vam.Beam, ((8, 8), 0.0)),
        (vam.Turntable, (0,)),
    ],
)
def test_bad_geometry_is_refused(kind: type, arguments: tuple) -> None:
    with pytest.raises(BadInput, match="expected"):
        kind(*arguments)
