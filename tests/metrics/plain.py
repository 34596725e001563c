"""The metrics again, in plain NumPy on a sorted list of voxels: slow, obvious, and independent of any kernel."""

from __future__ import annotations

import numpy as np


def split(dose: np.ndarray, target: np.ndarray, level: float = 0.5) -> tuple[np.ndarray, np.ndarray]:
    """Doses (out of, in) the part within the inscribed cylinder."""
    nx, ny, _ = dose.shape
    x, y = np.arange(nx) - (nx - 1) / 2, np.arange(ny) - (ny - 1) / 2
    inside = np.hypot(x[:, None], y[None, :]) <= (min(nx, ny) - 1) / 2 + 1e-9
    judged = np.broadcast_to(inside[:, :, None], dose.shape)
    return dose[judged & (target < level)], dose[judged & (target >= level)]


def best_iou(out: np.ndarray, into: np.ndarray) -> float:
    """The greatest intersection over union of all thresholds, by trying the dose of every voxel."""
    values = np.unique(np.concatenate([out, into]))
    printed = len(into) - np.searchsorted(np.sort(into), values, side="left")
    excess = len(out) - np.searchsorted(np.sort(out), values, side="left")
    return float((printed / (len(into) + excess)).max())


def example(shape: tuple[int, int, int], seed: int, noise: float) -> tuple[np.ndarray, np.ndarray]:
    """(dose, target), float32: an off-center ball with a soft edge that leaves the last slices empty."""
    rng = np.random.default_rng(seed)
    x, y, z = np.meshgrid(*(np.linspace(-1, 1, n) if n > 1 else np.zeros(1) for n in shape), indexing="ij")
    radius = np.sqrt((x - 0.1) ** 2 + y**2 + (z + 0.3) ** 2)
    target = np.clip((0.6 - radius) * 8 + 0.5, 0, 1)
    dose = 3.0 * np.exp(-(radius**2)) + noise * rng.standard_normal(shape)
    return np.maximum(dose, 0).astype(np.float32), target.astype(np.float32)
