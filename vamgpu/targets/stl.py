"""STL files, read as far as they are whole."""

from __future__ import annotations

import re

import numpy as np
import numpy.typing as npt

from vamgpu.errors import MeshError
from vamgpu.quantity import counted
from vamgpu.targets.solid import unmatched_edges

Corners = npt.NDArray[np.float64]
RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("more", "<u2")])
HEAD = 84  # bytes before the first triangle of a binary file; the last four count the triangles
NAMES = re.compile(rb"(?m)^\s*(?:end)?solid\b[^\n]*?(?=\bfacet\b|$)")
VERTEX = re.compile(rb"\bvertex\s+(\S+)\s+(\S+)\s+(\S+)")


def read_stl(data: bytes, name: str) -> tuple[Corners, tuple[str, ...]]:
    """Corners [triangle, corner, axis] and what was left out of the file. Raises `MeshError`."""
    corners, notes = _binary(data, name) if b"\0" in data[:512] else _text(data, name)
    if odd := int((~np.isfinite(corners)).any(axis=(1, 2)).sum()):  # they would leave holes
        raise MeshError(f"{name}: {odd} of {len(corners)} triangles have corners that are NaN or infinite; expected "
                        "finite numbers: export the part again")  # fmt: skip
    return corners, notes


def _binary(data: bytes, name: str) -> tuple[Corners, tuple[str, ...]]:
    """As many triangles as the header counts, or as there are if only these close the surface."""
    count, room = int.from_bytes(data[80:HEAD], "little"), max(0, len(data) - HEAD) // RECORD.itemsize
    corners = np.frombuffer(data, RECORD, room, HEAD)["corners"].astype(float) if room else np.zeros((0, 3, 3))
    kept = min(count, room)
    rest = len(data) - HEAD - room * RECORD.itemsize
    if count == room + 1 and rest > 0 and room:
        return corners, (f"it ends inside triangle {count:,}, its last, which was left out",)
    if count != room and not _is_closed(corners[:kept]):
        if _is_closed(corners):
            kept = room
        elif count > room:
            raise MeshError(f"{name} says that it has {count} triangles but ends after {room}; it is cut off or no "
                            "STL: copy or export it again")  # fmt: skip
    notes = (f"its header counts {count:,} triangles, and {kept:,} were read",) if kept != count else ()
    if rest := len(data) - HEAD - kept * RECORD.itemsize:
        notes += (f"left out: {counted(rest, 'byte', ',')} after the last triangle",)
    return corners[:kept], notes


def _text(data: bytes, name: str) -> tuple[Corners, tuple[str, ...]]:
    text = NAMES.sub(b"", data.replace(b"\r", b"\n").lower().replace(b",", b"."))
    end = text.rfind(b"endfacet")
    count, words = text.count(b"endfacet"), VERTEX.findall(text, 0, max(end, 0))
    if len(words) != 3 * count:
        raise MeshError(f"{name} has {len(words)} vertices in {count} triangles; expected three in each: it is damaged "
                        "or no STL, export the part again")  # fmt: skip
    try:
        corners = np.array(words).astype(np.float64).reshape(-1, 3, 3)
    except ValueError as error:
        raise MeshError(f"{name}: {error} at a vertex; expected three numbers: export the part again") from error
    notes = ("it ends inside a triangle, which was left out",) if b"facet" in text[end + 8 :] else ()
    return corners, notes if b"endsolid" in data.lower() else (*notes, "it has no line endsolid and may be cut off")


def _is_closed(corners: Corners) -> bool:
    if not len(corners) or not np.isfinite(corners).all():
        return False
    _, places = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    return places.max() > 2 and not len(unmatched_edges(places.reshape(-1, 3)))
