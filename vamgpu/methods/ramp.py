"""Filters along r: tables of taps for a projector."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.kernels.filter import filter_rows
from vamgpu.methods.quadrature import balance
from vamgpu.operators.protocol import Operator
from vamgpu.operators.reductions import dot
from vamgpu.operators.web_motion import WebMotion
from vamgpu.web import WebGrid


@dataclass(frozen=True, eq=False)
class Taps:
    """One side of a symmetric filter; taps between multiples of ``stride`` (counted from the first) are zero."""

    table: DeviceArray
    stride: int
    balance: DeviceArray | None = None  # factor of each angle's light; None if angles are even and lit equally long


def ramp(operator: Operator) -> Taps:
    """The band-limited ramp, scaled so that Aᵀ·ramp·A is near the identity for straight rays that nothing absorbs."""
    columns = operator.beam.pixels[0]
    return Taps(operator.device.table(_ramp_taps(columns) * _scale(operator)), 2, _balance(operator))


def _ramp_taps(columns: int) -> np.ndarray:
    taps = np.zeros(columns)
    taps[0] = 0.25
    taps[1::2] = -1.0 / (np.pi * np.arange(1, columns, 2)) ** 2
    return taps


def capped_ramp(operator: Operator, cap: float, span: float = 1.0) -> Taps:
    """The ramp |ω| up to ``cap`` cycles per column, level beyond; its taps fade out over a ``span`` of the columns."""
    columns = operator.beam.pixels[0]
    frequency = np.abs(np.fft.fftfreq(8 * columns))
    taps = np.real(np.fft.ifft(np.minimum(frequency, cap)))[:columns]
    if span < 1.0:
        count = min(columns, max(8, round(span * columns)))
        taps = taps[:count] * np.cos(0.5 * np.pi * np.arange(count) / count) ** 2
    return Taps(operator.device.table(taps * _scale(operator)), 1, _balance(operator))


def identity(operator: Operator) -> Taps:
    """No filter."""
    return Taps(operator.device.table(np.ones(1)), 1)


def _scale(operator: Operator) -> float:
    grid, motion = operator.grid, operator.motion
    if isinstance(grid, WebGrid):
        return _web_scale(operator, grid)
    assert not isinstance(motion, WebMotion)
    # A voxel of Aᵀ gathers pitch² / beam pitch from each angle; the inversion formula needs π per half turn
    area = grid.pitch**2 / operator.beam.pitch
    return np.pi / motion.angles / area / operator.beam.pitch


def _balance(operator: Operator) -> DeviceArray | None:
    found = None if isinstance(operator.motion, WebMotion) else balance(operator.motion)
    return None if found is None else operator.device.table(found)


def bar(grid: WebGrid) -> np.ndarray:
    """A round bar across the middle of a web, with a diameter of half its thickness: 0 and 1 [l, rho, z]."""
    along = (np.arange(grid.shape[0]) - grid.shape[0] // 2) * grid.edges[0]  # its voxels are the same for any length
    deep = grid.axes()[1] - 0.5 * grid.size[1]
    inside = np.hypot(along[:, None], deep[None, :]) <= 0.25 * grid.size[1] * (1.0 + 1e-6)
    return np.broadcast_to(inside.astype(np.float32)[:, :, None], grid.shape)  # which takes no memory


def _web_scale(operator: Operator, grid: WebGrid) -> float:
    # For light that fades over less than half a turn there is no closed formula: the factor is measured with a bar
    device, columns = operator.device, operator.beam.pixels[0]
    target, projected, shown = device.upload(bar(grid)), *map(device.empty, (operator.range.shape,) * 2)
    operator(target, out=projected)
    taps = device.table(_ramp_taps(columns))
    device.launch(filter_rows, sinogram=projected, taps=taps, stride=2, floor=-3e38, filtered=shown)
    back = operator.T(shown)
    return dot(target, target) / max(dot(back, target), 1e-30)
