"""The target that the peers optimize: a mesh as a binary volume [x, y, z] that fits the inscribed cylinder."""

from __future__ import annotations

import numpy as np


def voxels(mesh_file: str, n: int, fill: float = 0.95) -> np.ndarray:
    """Return the mesh as a boolean (n, n, n) array by trimesh's own voxelizer, z upwards.

    The part is centred by its box and scaled so that it keeps inside `fill` of the cylinder's radius and height.
    """
    import trimesh

    mesh = trimesh.load_mesh(mesh_file)
    mesh.apply_translation(-mesh.bounds.mean(axis=0))
    radius = np.linalg.norm(mesh.vertices[:, :2], axis=1).max()
    mesh.apply_scale(0.5 * fill * n / max(radius, 0.5 * mesh.extents[2]))
    grid = mesh.voxelized(pitch=1.0).fill()
    index = np.round(grid.points + 0.5 * (n - 1)).astype(int)
    index = index[np.all((index >= 0) & (index < n), axis=1)]
    out = np.zeros((n, n, n), dtype=bool)
    out[tuple(index.T)] = True
    return out


def strict_window(dose: np.ndarray, part: np.ndarray) -> dict[str, float]:
    """Return (min in-part - max out-of-part) / max and the best-threshold IoU, in the inscribed cylinder."""
    n = part.shape[0]
    x = np.arange(n) - 0.5 * (n - 1)
    disk = (x[:, None] ** 2 + x[None, :] ** 2 <= (0.5 * n) ** 2)[:, :, None]
    inside, outside = dose[part & disk], dose[~part & disk]
    top = float(max(inside.max(), outside.max()))
    best = 0.0
    for threshold in np.linspace(0.0, top, 201)[1:-1]:
        hit = float((inside > threshold).sum())
        best = max(best, hit / (inside.size + float((outside > threshold).sum())))
    return {"strict_window": round((float(inside.min()) - float(outside.max())) / top, 4), "iou": round(best, 5)}
