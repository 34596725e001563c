"""PLY files in all three encodings, with faces of any number of corners."""

from __future__ import annotations

from struct import error as Ended
from struct import unpack_from

import numpy as np
import numpy.typing as npt

from vamgpu.errors import EmptyMesh, MeshError

HEAD = 1 << 16  # bytes that a header has at most
TYPES = {
    "char": "b", "int8": "b", "uchar": "B", "uint8": "B", "short": "h", "int16": "h", "ushort": "H", "uint16": "H",
    "int": "i", "int32": "i", "uint": "I", "uint32": "I", "float": "f", "float32": "f", "double": "d", "float64": "d",
}  # fmt: skip
ORDERS = {b"ascii": "=", b"binary_little_endian": "<", b"binary_big_endian": ">"}
CORNERS = ("vertex_indices", "vertex_index")  # names of the list of a face's vertices
Property = tuple[str, str, str]  # name, type, and type of a list's length or nothing
Faces = npt.NDArray[np.int64]


def read_ply(data: bytes, name: str) -> tuple[npt.NDArray[np.float64], Faces, tuple[str, ...]]:
    """Vertices, triangles, and what was left out of the file. Raises `MeshError`, `EmptyMesh`."""
    elements, start, is_text = _header(data, name)
    body = np.array(data[start:].split(), np.float64).tobytes() if is_text else data[start:]
    vertices, faces, at = np.zeros((0, 3)), [np.zeros((0, 3), np.int64)], 0
    for kind, count, properties in elements:
        try:
            if any(length for _, _, length in properties):
                found, at = _lists(count, properties, body, at)
                faces += [
                    each[:, [0, k, k + 1]] for each in found if kind == "face" for k in range(1, each.shape[1] - 1)
                ]
                continue
            rows = np.frombuffer(body, [each[:2] for each in properties], count, at)
        except (Ended, ValueError) as error:
            raise MeshError(f"{name} ends before the last of its {count:,} rows of {kind!r}; it is cut off: copy or "
                            "export it again") from error  # fmt: skip
        at += rows.nbytes
        if kind == "vertex":
            vertices = np.stack([rows[axis] for axis in "xyz"], 1).astype(np.float64)
    found = np.concatenate(faces)
    if not len(found):
        raise EmptyMesh(f"{name} has no faces; expected a mesh, not points: export the part again as a triangle mesh")
    if not 0 <= found.min() <= found.max() < len(vertices):
        raise MeshError(f"{name} has faces of vertices {found.min()} to {found.max()} among {len(vertices)}; it is "
                        "damaged: export the part again")  # fmt: skip
    rest = f"{(len(body) - at) // 8:,} numbers" if is_text else f"{len(body) - at:,} bytes"
    return vertices, found, (f"{rest} after the last row were left out",) if at < len(body) else ()


def _header(data: bytes, name: str) -> tuple[list[tuple[str, int, list[Property]]], int, bool]:
    """Elements, the first byte of the rows, and whether rows are text; in text, every type is a double."""
    head, mark, _ = data[:HEAD].partition(b"end_header")
    lines = [line.split() for line in head.splitlines() if line.strip()]
    form = next((line[1] for line in lines if line[0] == b"format" and len(line) > 1), b"none")
    if not mark or not head.startswith(b"ply") or form not in ORDERS:
        raise MeshError(f"{name!r} has no complete header with a format among {b', '.join(ORDERS).decode()}; "
                        "it is cut off or no PLY: copy or export it again")  # fmt: skip
    elements: list[tuple[str, int, list[Property]]] = []
    for words in ([word.decode("latin-1") for word in line] for line in lines):
        if words[0] == "element":
            elements.append((words[1], int(words[2]), []))
        elif words[0] == "property":
            kinds = [
                ORDERS[form] + ("d" if form == b"ascii" else TYPES[each]) for each in words[1:-1] if each != "list"
            ]
            elements[-1][2].append((words[-1], kinds[-1], kinds[0] if words[1] == "list" else ""))
    if (most := sum(count for _, count, _ in elements)) > len(data):
        raise MeshError(f"{name!r} declares {most:,} rows, but has {len(data):,} bytes; it is cut off or no PLY: copy "
                        "or export it again")  # fmt: skip
    end = data.find(b"\n", len(head))
    return elements, len(data) if end < 0 else end + 1, form == b"ascii"


def _lists(count: int, properties: list[Property], body: bytes, at: int) -> tuple[list[Faces], int]:
    """Vertices of faces, grouped by their number, and the byte after the last. Raises `struct.error`, `ValueError`."""
    types: list[tuple[str, str] | tuple[str, str, tuple[int]]] = []
    for name, kind, length in properties:
        if length:
            corners = int(unpack_from(length, body, at + np.dtype(types).itemsize)[0]) if count else 0
            types += [(f"n {name}", length), (name, kind, (corners,))]
        else:
            types += [(name, kind)]
    row = np.dtype(types)
    rows = np.frombuffer(body, row, min(count, (len(body) - at) // row.itemsize), at)
    if len(rows) == count and all(
        (rows[f"n {key}"] == row[key].shape).all() for key, _, length in properties if length
    ):
        return [rows[name].astype(np.int64) for name, _, _ in properties if name in CORNERS], at + rows.nbytes
    return _walked(count, properties, body, at)


def _walked(count: int, properties: list[Property], body: bytes, at: int) -> tuple[list[Faces], int]:
    """The same, for rows of different sizes."""
    plan = [(np.dtype(kind).itemsize, length, np.dtype(length or kind).itemsize, name in CORNERS)
            for name, kind, length in properties]  # fmt: skip
    places: dict[int, list[int]] = {}
    for _ in range(count):
        for size, length, width, wanted in plan:
            if length:
                corners = max(int(unpack_from(length, body, at)[0]), 0)
                if wanted:
                    places.setdefault(corners, []).append(at + width)
                at += size * corners
            at += width
        if at > len(body):
            raise Ended(f"{at - len(body)} bytes are missing")
    kind = next((kind for name, kind, _ in properties if name in CORNERS), "=b")
    every = np.frombuffer(body, np.uint8)
    return [every[np.array(starts)[:, None] + np.arange(corners * np.dtype(kind).itemsize)].view(kind).astype(np.int64)
            for corners, starts in places.items() if corners > 2], at  # fmt: skip
