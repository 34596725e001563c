"""Make a triangle soup watertight, or report why it is not."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from vamgpu.errors import MeshError, MeshWarning, NotWatertight
from vamgpu.targets.solid import Solid, unmatched_edges

Faces = npt.NDArray[np.int32]
Vertices = npt.NDArray[np.float64]
Mended = tuple[Vertices, Faces, tuple[str, ...]]  # a surface after a step of the repair, and a description of that step

_CRACK = 1e-5  # open borders closer than this share of the box diagonal are sewn together
_HOLE = 0.2  # holes whose rim is shorter than this share of the box diagonal are filled, and those of 3 or 4 edges


def repaired(solid: Solid) -> Solid:
    """Return a watertight, outward-wound copy of solid (the same object if nothing is wrong)."""
    # cracks up to 1e-5 of the box diagonal are sewn; holes of ≤ 4 edges, or below 0.2 of the diagonal, are filled
    vertices, faces, mended = solid.vertices, solid.faces, ()
    left = solid.open_edges
    if left:
        vertices, faces, mended, left = _closed(vertices, faces)
    if left:
        raise NotWatertight(
            f"{solid.name}: {left} open edges after merging vertices and filling small holes; expected a closed "
            "surface. Close the holes in the CAD program or a mesh editor (make solid / close holes) and export again"
        )
    vertices, faces, turned = _turn_outward(vertices, faces)
    mended += turned
    result = solid
    if vertices is not solid.vertices or faces is not solid.faces:
        result = replace(solid, vertices=vertices, faces=faces, mended=solid.mended + mended)
    low, high = result.bounds
    if not abs(result.volume) > 1e-9 * float(np.prod(high - low)):
        raise MeshError(f"{solid.name}: the surface encloses no volume; expected a solid part, not a sheet: thicken it")
    if mended:
        warnings.warn(
            f"{solid.name}: the mesh was repaired: {'; '.join(mended)}. Check the part before it is printed, or repair "
            "it in the CAD program and export it again",
            MeshWarning,
            stacklevel=3,
        )
    return result


def _closed(vertices: Vertices, faces: Faces) -> tuple[Vertices, Faces, tuple[str, ...], int]:
    """The surface after the steps needed to close it, descriptions of these steps, and the remaining open edges."""
    vertices, where = np.unique(vertices, axis=0, return_inverse=True)
    faces = where.reshape(-1)[faces].astype(np.int32)
    left, mended = len(unmatched_edges(faces)), ()
    for step in (_drop_bad_faces, _sew_cracks, _fix_winding, _fill_holes):
        if not left:
            break
        vertices, faces, done = step(vertices, faces)
        left, mended = len(unmatched_edges(faces)), mended + done
    return vertices, faces, mended, left


def _said(number: int, one: str, many: str, rest: str) -> tuple[str, ...]:
    """Sentence on a repair; empty if the number is 0."""
    return (f"{number} {one if number == 1 else many} {rest}",) if number else ()


def _drop_bad_faces(vertices: Vertices, faces: Faces) -> Mended:
    a, b, c = faces.T
    kept = faces[(a != b) & (b != c) & (c != a)]
    _, first = np.unique(np.sort(kept, axis=1), axis=0, return_index=True)
    done = _said(len(faces) - len(kept), "triangle", "triangles", "without area removed")
    done += _said(len(kept) - len(first), "triangle", "triangles", "that duplicated others removed")
    return vertices, kept[np.sort(first)], done


def _sew_cracks(vertices: Vertices, faces: Faces) -> Mended:
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import KDTree

    border = np.unique(unmatched_edges(faces))
    pairs = KDTree(vertices[border]).query_pairs(_CRACK * _diagonal(vertices), output_type="ndarray")
    ones = np.ones(len(pairs))
    _, group = connected_components(coo_array((ones, (pairs[:, 0], pairs[:, 1])), shape=(len(border), len(border))))
    _, first = np.unique(group, return_index=True)
    target = np.arange(len(vertices), dtype=np.int32)
    target[border] = border[first[group]]
    sewn = _said(len(border) - len(first), "corner", "corners", "along cracks joined to a neighbor")
    vertices, faces, dropped = _drop_bad_faces(vertices, target[faces])
    return vertices, faces, sewn + dropped


def _fix_winding(vertices: Vertices, faces: Faces) -> Mended:
    """Wind neighbors consistently; each body keeps the sense of most of its area."""
    import trimesh

    mesh = trimesh.Trimesh(vertices, faces, process=False)
    trimesh.repair.fix_winding(mesh)
    fixed = np.asarray(mesh.faces, dtype=np.int32)
    before, after = _area_vectors(vertices, faces), _area_vectors(vertices, fixed)
    same = np.einsum("ij,ij->i", before, after)
    body = bodies(fixed, len(vertices))
    agreement = np.bincount(body, weights=same / np.maximum(_norm(after), 1e-300))
    wrong = agreement[body] < 0.0
    fixed[wrong] = fixed[wrong][:, ::-1]
    turned = int(np.where(wrong, same > 0.0, same < 0.0).sum())
    return vertices, fixed, _said(turned, "triangle", "triangles", "turned to face as their neighbors do")


def _fill_holes(vertices: Vertices, faces: Faces) -> Mended:
    limit = _HOLE * _diagonal(vertices)
    points, patches, rims = [vertices], [faces], []
    count = len(vertices)
    for loop in _loops(unmatched_edges(faces)):
        rim = vertices[loop]
        length = float(_norm(rim - np.roll(rim, 1, axis=0)).sum())
        if len(loop) < 3 or (len(loop) > 4 and length > limit):
            continue
        rims.append(len(loop))
        if len(loop) == 3:
            patches.append(np.array([loop[::-1]], dtype=np.int32))
            continue
        points.append(rim.mean(axis=0, keepdims=True))
        patches.append(np.array([(b, a, count) for a, b in zip(loop, np.roll(loop, -1), strict=True)], dtype=np.int32))
        count += 1
    done = _said(len(rims), "hole", "holes", f"closed (rims of up to {max(rims, default=0)} edges)")
    return np.concatenate(points), np.concatenate(patches), done


def _loops(edges: npt.NDArray[np.int64]) -> list[list[int]]:
    """Chain directed edges into closed loops of vertices; chains that do not close are left out."""
    follow: dict[int, list[int]] = {}
    for start, end in edges.tolist():
        follow.setdefault(start, []).append(end)
    loops: list[list[int]] = []
    for start in list(follow):
        while follow[start]:
            path, seen = [start], {start: 0}
            while follow.get(path[-1]):
                step = follow[path[-1]].pop()
                if step in seen:  # cut off the closed loop; rims that touch in one vertex stay separate
                    loops.append(path[seen[step] :])
                    for vertex in path[seen[step] + 1 :]:
                        del seen[vertex]
                    del path[seen[step] + 1 :]
                else:
                    seen[step] = len(path)
                    path.append(step)
    return loops


def _turn_outward(vertices: Vertices, faces: Faces) -> Mended:
    """Flip everything if the total volume is negative; then flip inward bodies that are not in outward ones."""
    if not len(faces):
        return vertices, faces, ()
    body = bodies(faces, len(vertices))
    origin = vertices.mean(axis=0)
    a, b, c = np.moveaxis((vertices - origin)[faces], 1, 0)
    volume = np.bincount(body, weights=np.einsum("ij,ij->i", a, np.cross(b, c)) / 6.0)
    flip = np.full(len(volume), volume.sum() < 0.0)
    volume = np.abs(volume.sum()) / (volume.sum() or 1.0) * volume
    low, high = np.full((2, len(volume), 3), [[[np.inf]], [[-np.inf]]])
    outward, inward = volume > 0.0, np.flatnonzero(volume < 0.0)
    for corner in faces.T if inward.size else ():
        np.minimum.at(low, body, vertices[corner])
        np.maximum.at(high, body, vertices[corner])
    for index in inward:
        inside = outward & (low <= low[index]).all(axis=1) & (high >= high[index]).all(axis=1)
        if not inside.any():
            flip[index] = not flip[index]
    if not flip.any():
        return vertices, faces, ()
    done = _said(int(flip.sum()), "body", "bodies", f"of {len(flip)} wound the wrong way, turned")
    return vertices, np.where(flip[body][:, None], faces[:, ::-1], faces), done


def bodies(faces: Faces, vertices: int) -> npt.NDArray[np.intp]:
    """Number of the connected body of each face (bodies share no vertex)."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    rows, columns = np.concatenate([faces[:, 0], faces[:, 1]]), np.concatenate([faces[:, 1], faces[:, 2]])
    _, label = connected_components(coo_array((np.ones(len(rows), np.int8), (rows, columns)), (vertices, vertices)))
    _, body = np.unique(label[faces[:, 0]], return_inverse=True)
    return body.reshape(-1)


def _area_vectors(vertices: Vertices, faces: Faces) -> Vertices:
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    return 0.5 * np.cross(b - a, c - a)


def _norm(vectors: Vertices) -> Vertices:
    return np.sqrt(np.einsum("ij,ij->i", vectors, vectors))


def _diagonal(vertices: Vertices) -> float:
    return float(np.linalg.norm(np.ptp(vertices, axis=0)))
