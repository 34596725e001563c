"""What the steps of transport that are compared start from, and how far they go."""

from __future__ import annotations

import numpy as np

SPREAD = np.array([[0.12, 0.12, 0.054], [0.025, 0.025, 0.011], [0.02, 0.02, 0.009]], np.float32)
RATES = np.array([0.01, 0.008, 0.006, 0.02, 0.05], np.float32)


def start(n: int) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Species and light; what vamgpu's script starts from."""
    rng = np.random.default_rng(0)
    species = [(0.5 + 0.5 * rng.random((n, n, n), np.float32)) for _ in range(3)]
    return species, [rng.random((n, n, n), np.float32) for _ in range(2)]
