"""The window over tolerance of doses that are known functions of the depth."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

import vamgpu as vam
from vamgpu import Grid
from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput
from vamgpu.kernels.update import linear
from vamgpu.metrics.tolerance import Depth, ToleranceWindow, depth_of_fractions, depth_of_target, tolerance_window

GRID = Grid((28, 26, 24), 0.1)
FINE = 0.05
RADIUS = 0.8


@dataclass
class FineSlab:
    dose: np.ndarray
    x: np.ndarray
    y: np.ndarray
    z: np.ndarray


def positions() -> list[np.ndarray]:
    """Of voxels half as wide, moved by a quarter of the part's own."""
    return [axis + 0.025 for axis in Grid((56, 52, 48), FINE).axes()]


def ball(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Depth in a ball [mm]."""
    return RADIUS - np.sqrt((x[:, None, None] - 0.03) ** 2 + (y[None, :, None] + 0.02) ** 2 + z[None, None, :] ** 2)


def later(depth: Callable[..., np.ndarray]) -> Depth:
    """As a field that keeps every digit."""
    return lambda *axes: vam.open_device("numpy").upload(depth(*axes))


def slabs(dose: np.ndarray, thick: int = 11) -> Iterator[FineSlab]:
    x, y, z = positions()
    for start in range(0, len(z), thick):
        yield FineSlab(dose[:, :, start : start + thick], x, y, z[start : start + thick])


def soft(depth: np.ndarray) -> np.ndarray:
    """A dose that rises through the surface over 0.2 mm."""
    return np.clip(0.5 + 2.5 * depth, 0.1, 0.9)


def test_a_soft_edge_gives_the_window_it_must() -> None:
    dose = soft(ball(*positions()))
    found = tolerance_window(slabs(dose), later(ball), GRID.pitch)
    assert found.distance[0] == 0 and found.distance[-1] == pytest.approx(0.2)
    for distance in (0.0, 0.025, 0.05, 0.1, 0.15, 0.2):
        wanted = (min(0.5 + 2.5 * distance, 0.9) - max(0.5 - 2.5 * distance, 0.1)) / 0.9
        assert found.at(distance) == pytest.approx(wanted, abs=0.02)
        assert found.at(distance) >= wanted - 1e-4
    assert (np.diff(found.window) >= 0).all()
    assert found.judged_at(0.0) == 1 and found.judged_at(0.1) == pytest.approx((0.7 / 0.8) ** 3, rel=0.01)


def test_the_thickness_of_slabs_does_not_matter() -> None:
    dose = soft(ball(*positions())) + 0.05 * np.random.default_rng(0).random((56, 52, 48))
    one, many = (tolerance_window(slabs(dose, n), later(ball), GRID.pitch) for n in (48, 5))
    assert np.array_equal(one.window, many.window) and np.array_equal(one.judged, many.judged)


def test_the_curve_is_the_definition() -> None:
    """Against every voxel counted at once, with a dose that is noise, and greater at the rim of what counts."""
    dose, depth = np.random.default_rng(1).random((56, 52, 48)), ball(*positions())
    x, y, _ = positions()
    disc = np.broadcast_to((x[:, None] ** 2 + y[None, :] ** 2 <= 1.1**2)[:, :, None], dose.shape)
    last = np.flatnonzero(disc[26, :, 0])[-1]
    dose[26, last : last + 2, 5] = 2.0, 3.0
    found = tolerance_window(slabs(dose), later(ball), GRID.pitch, radius=1.1)
    for distance, window in zip(found.distance[::7], found.window[::7], strict=True):
        inside, outside = disc & (depth >= max(distance, 0)), disc & (depth < 0) & (-depth >= distance)
        wanted = (dose[inside].min() - dose[outside].max(initial=0.0)) / dose[disc].max()
        assert window == pytest.approx(wanted, abs=1e-12)


def test_depths_of_coarse_fractions_serve_a_fine_dose() -> None:
    moves = np.stack(np.meshgrid(*[np.linspace(-0.04, 0.04, 5)] * 3), -1).reshape(-1, 3)
    filled = [ball(*(a + d for a, d in zip(GRID.axes(), move, strict=True))) > 0 for move in moves]
    depth, axes = depth_of_fractions(np.mean(filled, axis=0), GRID), positions()
    true = ball(*axes)
    near = np.abs(true) < 0.18
    assert np.sqrt(np.mean((depth(*axes).numpy() - true)[near] ** 2)) < 0.06 * GRID.pitch
    dose = soft(true)
    exact, found = (tolerance_window(slabs(dose), d, GRID.pitch) for d in (later(ball), depth))
    assert found.at(0.05) == pytest.approx(exact.at(0.05), abs=0.06)


def test_depths_of_a_part_that_is_sampled_again() -> None:
    def resampled(grid: Grid, shift: tuple[float, float, float], device: Device | None) -> DeviceArray:
        axes = [axis + move for axis, move in zip(grid.axes(), shift, strict=True)]
        return vam.open_device(device).upload(np.clip(ball(*axes) / grid.pitch + 0.5, 0, 1))

    depth = depth_of_target(SimpleNamespace(resampled=resampled), FINE, GRID.pitch)  # type: ignore[arg-type]
    x, y, z = positions()
    for part in (slice(0, 9), slice(20, 31), slice(47, 48)):
        true, found = ball(x, y, z[part]), depth(x, y, z[part]).numpy()
        assert found.shape == true.shape
        assert np.abs(found - true)[np.abs(true) < 0.19].max(initial=0.0) < 0.4 * FINE


def test_a_flat_part_ends_beside_but_neither_above_nor_below() -> None:
    depth = depth_of_fractions(np.ones((6, 6, 1)), grid := Grid((6, 6, 1), 0.1), flat=True)
    x, y, _ = grid.axes()
    found = depth(x, y, np.array([-0.05, 0.0, 0.05])).numpy()
    assert found[2, 2] == pytest.approx([0.25] * 3, abs=1e-3) and found[0, 2] == pytest.approx([0.05] * 3, abs=1e-3)
    found = depth_of_fractions(np.ones((6, 6, 1)), grid)(x, y, np.zeros(1)).numpy()
    assert found[2, 2] == pytest.approx(0.05, abs=1e-3)


def test_what_lies_beyond_the_own_grid_is_outside() -> None:
    depth = depth_of_fractions(np.ones((4, 4, 4)), Grid((4, 4, 4), 0.1))
    at = np.array([-0.4, -0.25, 0.0, 0.25, 0.4])
    found = depth(at, np.zeros(1), np.zeros(1)).numpy().ravel()
    assert found == pytest.approx([-0.2, -0.05, 0.15, -0.05, -0.2], abs=0.02)  # as deep as the deepest centers


def test_a_part_thinner_than_the_tolerance_has_no_window_there() -> None:
    def sheet(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        return np.broadcast_to((0.04 - np.abs(x))[:, None, None], (len(x), len(y), len(z)))

    x, y, z = positions()
    found = tolerance_window(slabs(dose := 1.0 + sheet(x, y, z)), later(sheet), GRID.pitch)
    assert found.at(0.0) > 0 and np.isnan(found.at(0.05)) and found.judged_at(0.05) == 0
    assert found.limits(0.1) == (np.inf, dose[sheet(x, y, z) <= -0.1].max())


def test_the_peak_is_the_greatest_dose_of_all() -> None:
    dose = soft(ball(*positions()))
    dose[28, 26, 24] = 3.0
    assert tolerance_window(slabs(dose), later(ball), GRID.pitch).peak == 3.0


def test_wrong_input_is_refused() -> None:
    dose = soft(ball(*positions()))
    found = tolerance_window(slabs(dose), later(ball), GRID.pitch)
    for distance in (-0.01, 0.3, np.nan):
        with pytest.raises(BadInput, match=r"expected 0\.\.0\.2 mm"):
            found.at(distance)
    with pytest.raises(BadInput, match="holds NaN"):
        tolerance_window(slabs(np.where(dose > 0.85, np.nan, dose)), later(ball), GRID.pitch)
    with pytest.raises(BadInput, match="no voxel of the part"):
        tolerance_window(slabs(dose), later(lambda *axes: -np.ones_like(ball(*axes))), GRID.pitch)
    with pytest.raises(BadInput, match="voxel"):
        tolerance_window(slabs(dose), later(ball), 0.0)
    for bins in (0, 0.5, np.nan, "a"):
        with pytest.raises(BadInput, match="bins"):
            tolerance_window(slabs(dose), later(ball), GRID.pitch, bins=bins)  # type: ignore[arg-type]
    with pytest.raises(BadInput, match="a slab's dose has shape"):
        tolerance_window([FineSlab(dose[:-1], *positions())], later(ball), GRID.pitch)
    assert isinstance(found, ToleranceWindow)


def test_a_dose_on_a_device_is_judged_there(fast_device: Device) -> None:
    dose, depth = soft(ball(*positions())).astype(np.float32), ball(*positions()).astype(np.float32)
    whole = FineSlab(fast_device.upload(dose), *positions())  # type: ignore[arg-type]
    found = tolerance_window([whole], lambda *_: fast_device.upload(depth), GRID.pitch, radius=1.0)
    wanted = tolerance_window(slabs(dose), later(lambda *axes: depth[:, :, np.isin(positions()[2], axes[2])]),
                              GRID.pitch, radius=1.0)  # fmt: skip
    assert found.window == pytest.approx(wanted.window, abs=1e-6) and found.peak == wanted.peak
    assert found.judged == pytest.approx(wanted.judged, abs=1e-4)
    bad = fast_device.empty(dose.shape)
    fast_device.launch(linear, a=3e38, x=whole.dose, b=3e38, y=whole.dose, floor=-3e38, out=bad)
    with pytest.raises(BadInput, match="holds NaN"):
        tolerance_window([replace(whole, dose=bad)], lambda *_: fast_device.upload(depth), GRID.pitch)
