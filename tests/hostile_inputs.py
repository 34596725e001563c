"""Files that are made to harm: each must end as an error of its kind, soon and in little memory.

``python hostile_inputs.py FOLDER`` makes them there, reads each in a child of its own, and prints what became of it.
"""

from __future__ import annotations

import json
import os
import resource
import signal
import socket
import struct
import sys
import warnings
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from vamgpu.calibration.pointspread import PointSpread
from vamgpu.chemistry.history import ResinHistory
from vamgpu.chemistry.materials.resin import Resin
from vamgpu.curethrough.stack import open_stack
from vamgpu.errors import BadInput, JobError, MaterialError, MeshError, SliceError, StorageError, VamError
from vamgpu.hosts.records.record import MAGIC, read_run
from vamgpu.hosts.rigs.config import read_rig
from vamgpu.jobs.curethrough import read_curethrough
from vamgpu.jobs.foreign.drtvam import read_drtvam
from vamgpu.jobs.foreign.pictures import Layout, read_pictures
from vamgpu.jobs.foreign.vamtoolbox import read_vamtoolbox
from vamgpu.jobs.limits import read_limits
from vamgpu.jobs.read import read_job
from vamgpu.jobs.run import prove
from vamgpu.jobs.web import is_web, read_web
from vamgpu.printing.folder import load_frames
from vamgpu.printing.gray import GrayCurve
from vamgpu.storage.films import read_film
from vamgpu.storage.folder import Entry, Folder, write_folder
from vamgpu.storage.numpy_files import map_npy, read_npz
from vamgpu.storage.tables import read_columns
from vamgpu.targets.mesh import load_mesh
from vamgpu.webs.store import WebFolder

SECONDS, MEMORY = 10, 250_000_000
"""What an error may take: seconds of the processor, and bytes of memory more than there were in use before."""
PATIENCE = 60
"""Seconds until a child that waits, and so does no work, is ended: for a pipe, say, that nobody writes to."""
BUDGET = "2GB"
SPACES = b" " * 1_000_000
Error = type[VamError] | tuple[type[VamError], ...]
Case = tuple[Callable[[Path], Path], Callable[[Path], Any], Error]
CASES: dict[str, Case] = {}


def pictures(path: Path) -> Any:
    return read_pictures(path, Layout())


BOX = "v 0 0 0\nv 9 0 0\nv 0 9 0\nv 0 0 9\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"
MODEL = (
    '<?xml version="1.0"?>{head}<model unit="millimeter" '
    'xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02"><resources><object id="1" type="model"><mesh>'
    '<vertices><vertex x="0" y="0" z="0"/><vertex x="9" y="0" z="0"/><vertex x="0" y="9" z="0"/>'
    '<vertex x="0" y="0" z="9"/></vertices><triangles><triangle v1="0" v2="2" v3="1"/>'
    '<triangle v1="0" v2="1" v3="3"/><triangle v1="1" v2="2" v3="3"/><triangle v1="2" v2="0" v3="3"/></triangles>'
    '</mesh></object>{more}</resources><build><item objectid="{item}"/></build></model>'
)


def case(name: str, make: Callable[[Path], Path], read: Callable[[Path], Any], error: Error) -> None:
    CASES[name] = (make, read, error)


def text(name: str, words: str | bytes) -> Callable[[Path], Path]:
    """A file."""

    def make(folder: Path) -> Path:
        (folder / name).write_bytes(words if isinstance(words, bytes) else words.encode())
        return folder / name

    return make


def pipe(path: Path) -> None:
    path.unlink(missing_ok=True)
    os.mkfifo(path)


def zero(path: Path) -> None:
    path.unlink(missing_ok=True)
    path.symlink_to("/dev/zero")


def plug(path: Path) -> None:
    path.unlink(missing_ok=True)
    here = os.getcwd()
    os.chdir(path.parent)  # names of sockets are short
    socket.socket(socket.AF_UNIX).bind(path.name)
    os.chdir(here)


def folder(path: Path) -> None:
    path.unlink(missing_ok=True)
    path.mkdir()


def loop(path: Path) -> None:
    path.unlink(missing_ok=True)
    path.symlink_to(path.name)


ODD = {"pipe": pipe, "endless device": zero, "socket": plug, "folder": folder, "loop of links": loop}


def in_place_of(name: str, read: Callable[[Path], Any], error: type[VamError], kinds: str = "") -> None:
    """A case for each thing that may lie where a file is expected."""
    for kind, put in ODD.items():

        def make(place: Path, put: Any = put) -> Path:
            put(place / name)
            return place / name

        if not kinds or kind in kinds:
            case(f"{kind} as {name} for {getattr(read, '__qualname__', read)}", make, read, error)


def job(place: Path) -> Path:
    """A sound job folder."""
    path = place / "a.vam"
    frames = np.random.default_rng(0).integers(0, 256, (4, 30, 40), np.uint8)
    write_folder(path, {"frames": Entry(frames, ("angle", "row", "column"))}, inputs={}, details={}, device="numpy")
    return path


def spoiled(spoil: Callable[[Path], Any]) -> Callable[[Path], Path]:
    """A job folder that something was done to."""

    def make(place: Path) -> Path:
        path = job(place)
        spoil(path)
        return path

    return make


def edited(name: str, edit: Callable[[Any], Any]) -> Callable[[Path], Path]:
    """A job folder with a JSON file that says something else."""

    def spoil(path: Path) -> None:
        data = json.loads((path / name).read_text())
        (path / name).write_text(json.dumps(edit(data) or data))

    return spoiled(spoil)


def put(data: Any, keys: str, value: Any) -> None:
    *most, last = [int(key) if key.isdigit() else key for key in keys.split(".")]
    for key in most:
        data = data[key]
    data[last] = value


def frames(path: Path) -> np.ndarray:
    return Folder.open(path).array("frames")


def one_frame(path: Path) -> np.ndarray:
    return Folder.open(path).one("frames", 2)


def claims(shape: list[int]) -> Callable[[Path], None]:
    """Zarr and manifest agree on a shape that is not there."""

    def spoil(path: Path) -> None:
        for name, keys in (("frames/zarr.json", "shape"), ("manifest.json", "arrays.frames.shape")):
            data = json.loads((path / name).read_text())
            put(data, keys, shape)
            if name != "manifest.json":
                put(data, "chunk_grid.configuration.chunk_shape", shape)
                put(data, "codecs.0.configuration.chunk_shape", [1, *shape[1:]])
            (path / name).write_text(json.dumps(data))

    return spoil


def chunk_bomb(path: Path) -> None:
    """Chunks that unpack to 400 MB, in a file whose index is as it should be."""
    from google_crc32c import value
    from numcodecs.zstd import compress

    bomb = compress(bytes(400_000_000), 1)
    index = struct.pack("<8Q", *(0, len(bomb)) * 4)
    (path / "frames/c/0/0/0").write_bytes(bomb + index + struct.pack("<I", value(index)))


def list_bomb(place: Path) -> Path:
    """A zip whose list has 400,000 members, in 23 MB."""
    names = [f"s{n:06d}.png".encode() for n in range(400_000)]
    head = b"PK\1\2" + struct.pack("<6H3I5H2I", 20, 20, 0, 0, 0, 33, 0, 0, 0, 11, 0, 0, 0, 0, 0, 0)
    whole = b"".join(head + name for name in names)
    ends = b"PK\5\6" + struct.pack("<4H2IH", 0, 0, 65535, 65535, len(whole), 0, 0)
    (place / "a.zip").write_bytes(whole + ends)
    return place / "a.zip"


def packed(
    name: str, members: dict[str, bytes], lie: int | None = None, spaces: int = 0, how: int = zipfile.ZIP_DEFLATED
) -> Callable[[Path], Path]:
    """A zip. lie: unpacked bytes of each member, as its list has them, with a check sum to match.  spaces: MB more."""

    def make(place: Path) -> Path:
        with zipfile.ZipFile(place / name, "w", how, compresslevel=1) as file:
            for member, data in members.items():
                with file.open(member, "w") as out:
                    out.write(data)
                    for _ in range(spaces):
                        out.write(SPACES)
                if lie is not None:
                    file.filelist[-1].file_size = lie
                    file.filelist[-1].CRC = zlib.crc32((data + SPACES)[:lie])
        return place / name

    return make


def model(head: str = "", more: str = "", item: int = 1) -> dict[str, bytes]:
    return {"3D/3dmodel.model": MODEL.format(head=head, more=more, item=item).encode()}


def component(number: int, *others: int) -> str:
    inner = "".join(f'<component objectid="{other}"/>' for other in others)
    return f'<object id="{number}" type="model"><components>{inner}</components></object>'


def png(rows: int, columns: int) -> bytes:
    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    packer, row = zlib.compressobj(9), bytes(columns + 1)
    body = b"".join(packer.compress(row) for _ in range(rows)) + packer.flush()
    head = struct.pack(">2I5B", columns, rows, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", body) + chunk(b"IEND", b"")


def black(place: Path) -> Path:
    """24 black slices of 11,500² pixels in 3 MB."""
    (place / "s").mkdir()
    (place / "s" / "s0.png").write_bytes(png(11500, 11500))
    for k in range(1, 24):
        os.link(place / "s" / "s0.png", place / "s" / f"s{k}.png")
    return place / "s"


def among_slices(odd: Callable[[Path], None]) -> Callable[[Path], Path]:
    def make(place: Path) -> Path:
        (place / "s").mkdir()
        for k in range(3):
            (place / "s" / f"s{k}.png").write_bytes(png(4, 5))
        odd(place / "s" / "s1.png")
        return place / "s"

    return make


def slices(path: Path) -> np.ndarray:
    with open_stack(path) as stack:
        return stack[0 : stack.shape[0]]


def npy(shape: str, kind: str = "<f4", data: bytes = b"") -> bytes:
    head = f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}\n".encode()
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(head)) + head + data


def npz(members: dict[str, bytes]) -> Callable[[Path], Path]:
    return packed("a.npz", members)


def web(words: str) -> Callable[[Path], Path]:
    def make(place: Path) -> Path:
        (place / "web.json").write_text(words)
        return place

    return make


def run(name: str, words: str | None = None) -> Callable[[Path], Path]:
    """A run's folder with one file that is odd."""

    def make(place: Path) -> Path:
        good = {"run.json": "{}", "state.json": '{"state": "complete", "message": ""}', "events.jsonl": ""}
        for file, said in good.items():
            (place / file).write_text(said)
        (place / "shown.bin").write_bytes(MAGIC)
        read_run(place)  # it is sound so far
        pipe(place / name) if words is None else (place / name).write_text(words)
        return place

    return make


# TOML
for reader in (read_job, read_web, read_curethrough, read_limits, read_rig):
    in_place_of("a.toml", reader, JobError)
for what, words in {
    "nested 3,000 deep": "a=" + "[" * 3000,
    "nested 60 deep in dotted keys": "".join("{" + ".".join("a" * 60) + "=" for _ in range(60)).replace("{", "x=", 1)
    + "1"
    + "}" * 59,
    "with a key of 20,000 parts": ".".join(["a"] * 20000) + "=1",
    "with a table of 20,000 parts": "[" + ".".join(["'a'"] * 20000) + "]",
    "with a number of 10,000 digits": "a=" + "9" * 10000,
    "with an integer of 100 digits": "[turntable]\nangles=" + "9" * 100,
    "of 3 MB": "#" * 3_000_000,
    "with 50,000 unknown keys": "".join(f"k{n}=1\n" for n in range(50000)),
    "without a word": "",
    "that is an image": png(4, 4),
}.items():
    case(f"TOML {what}", text("a.toml", words), read_job, JobError)
case("TOML that is no UTF-8, asked whether it is a web", text("a.toml", b"\xff\xfe"), is_web, JobError)
for odd_name in ("a\0b.toml", "a\nb.toml", "n" * 5000, "../" * 2000, ""):
    case(f"the name {odd_name[:8]!r}", lambda place, name=odd_name: Path(name), read_job, JobError)
for mesh in ("a\\u0000.stl", "n" * 5000, "pipe.stl"):

    def names(place: Path, mesh: str = mesh) -> Path:
        os.mkfifo(place / "pipe.stl")
        return text("a.toml", f'[target]\nmesh = "{mesh}"\n[beam]\npitch = "1 mm"')(place)

    case(f"a job that names {mesh[:10]}", names, read_job, JobError)
for name, reader, error in (
    ("gray.toml", GrayCurve.load, StorageError),
    ("result.toml", lambda path: PointSpread.load(path, 0.01), StorageError),
    ("resin.toml", Resin.load, MaterialError),
):
    in_place_of(name, reader, error, "pipe, endless device, loop of links")
    case(f"{name} nested 3,000 deep", text(name, "a=" + "[" * 3000), reader, BadInput)
in_place_of("a.csv", read_columns, StorageError)
case("CSV with a field of 200 kB", text("a.csv", 'a,b\n"' + "1" * 200_000), read_columns, StorageError)

# JSON
in_place_of("h.json", ResinHistory.load, StorageError)
for what, words in {"nested": "[" * 100_000, "NaN": '{"format": NaN}', "integers": '{"format": ' + "9" * 9999 + "}",
                    "infinity": '{"format": 1e999}', "nothing": "", "a number": "3"}.items():  # fmt: skip
    case(f"history: {what}", text("h.json", words), ResinHistory.load, StorageError)
    case(f"web.json: {what}", web(words), WebFolder.open, StorageError)
    case(f"manifest: {what}", spoiled(lambda path, words=words: (path / "manifest.json").write_text(words)),
         Folder.open, StorageError)  # fmt: skip
    for name in ("run.json", "state.json"):
        case(f"{name}: {what}", run(name, words), read_run, StorageError)
for name in ("run.json", "state.json", "shown.bin", "events.jsonl"):
    case(f"pipe as {name}", run(name), read_run, StorageError)
case("web.json that is a pipe", lambda place: (pipe(place / "web.json"), place)[1], WebFolder.open, StorageError)

# job folders
for name in ("manifest.json", "frames/zarr.json", "frames/c/0/0/0"):
    for kind, odd in ODD.items():
        case(f"{kind} as {name}", spoiled(lambda path, odd=odd, name=name: odd(path / name)), frames, StorageError)
case("a pipe as a chunk of one frame", spoiled(lambda path: pipe(path / "frames/c/0/0/0")), one_frame, StorageError)
for keys, value in (
    ("inputs", []), ("details", 3), ("device", {}), ("arrays", []), ("arrays.frames", None),
    ("arrays.frames.shape", ["4", 30, 40]), ("arrays.frames.shape", [4, -30, 40]), ("arrays.frames.shape", []),
    ("arrays.frames.shape", [10**18, 30, 40]), ("arrays.frames.dtype", "object"), ("arrays.frames.axes", 3),
    ("arrays.frames.sha256", 3), ("arrays", {"../../etc": {}}),
):  # fmt: skip
    case(f"manifest: {keys} {value}", edited("manifest.json", lambda data, keys=keys, value=value: put(
        data, keys, value)), frames, StorageError)  # fmt: skip
for keys, value in (
    ("shape", [10**12, 30, 40]), ("shape", [True, 30, 40]), ("data_type", "complex128"), ("data_type", "V9"),
    ("codecs", []), ("codecs.0.configuration.codecs.1.name", "gzip"),
    ("codecs.0.configuration.chunk_shape", [4, 30, 40]),
    ("chunk_grid.configuration.chunk_shape", [10**15, 30, 40]), ("chunk_grid.configuration.chunk_shape", [0, 30, 40]),
    ("chunk_grid.configuration.chunk_shape", []),
):  # fmt: skip
    case(f"zarr.json: {keys} {value}", edited("frames/zarr.json", lambda data, keys=keys, value=value: put(
        data, keys, value)), frames, StorageError)  # fmt: skip
case("zarr that says 18 GB", spoiled(claims([4000, 2000, 2250])), frames, StorageError)
case("zarr that says 18 GB, one frame", spoiled(claims([4000, 2000, 2250])), one_frame, StorageError)
case("zarr that says an exabyte", spoiled(claims([10**9, 10**5, 10**4])), frames, StorageError)
case("a chunk that unpacks to 400 MB", spoiled(chunk_bomb), frames, StorageError)
case("a chunk that unpacks to 400 MB, one frame", spoiled(chunk_bomb), one_frame, StorageError)
case("a file of chunks that is cut off", spoiled(lambda path: (path / "frames/c/0/0/0").write_bytes(b"1")), frames,
     StorageError)  # fmt: skip
case("a manifest of no frames", job, lambda path: load_frames(path, "numpy"), StorageError)
case("a manifest of no job", job, lambda path: prove(path, "numpy"), StorageError)
case("a name with a NUL", lambda place: place / "a\0b", Folder.open, StorageError)

# meshes
for ending in ("stl", "obj", "ply", "3mf"):
    in_place_of(f"a.{ending}", load_mesh, BadInput, "pipe, endless device, loop of links")
    for what, words in {"empty": b"", "an image": png(4, 4), "zeros": bytes(1000), "a TOML": b"a = 1\n"}.items():
        case(f"{ending} that is {what}", text(f"a.{ending}", words), load_mesh, MeshError)
case("STL of 4e9 triangles", text("a.stl", bytes(80) + struct.pack("<I", 4 * 10**9) + bytes(500)), load_mesh, MeshError)
for form in ("ascii", "binary_little_endian"):
    for element, rest in (("vertex", "property float x\n" * 3), ("face", "property list uchar int vertex_indices\n")):
        words = f"ply\nformat {form} 1.0\nelement {element} 4000000000\n{rest}end_header\n0 0 0\n"
        case(f"PLY of 4e9, {form}, {element}", text("a.ply", words), load_mesh, MeshError)
case("PLY list of 4e9", text("a.ply", b"ply\nformat binary_little_endian 1.0\nelement face 3\nproperty list uint int "
     b"vertex_indices\nend_header\n" + struct.pack("<3I", *[4 * 10**9] * 3)), load_mesh, MeshError)  # fmt: skip
dark = "mtllib /dev/zero\nusemtl a\n" + BOX.replace("4", "9")
case("OBJ that names an endless device", text("a.obj", dark), load_mesh, MeshError)
case("OBJ with an index of 4e9", text("a.obj", BOX + "f 1 2 4000000000\n"), load_mesh, MeshError)
case("STL of 1 GB of nothing", lambda place: sparse(place / "a.stl", 10**9), load_mesh, MeshError)


def sparse(path: Path, length: int) -> Path:
    with open(path, "wb") as file:
        file.truncate(length)
    return path


case("3MF bomb", packed("a.3mf", model(), lie=10**9), load_mesh, MeshError)
case("3MF bomb within the budget", packed("a.3mf", model(), spaces=100), load_mesh, MeshError)
case("3MF that unpacks to more than it says", packed("a.3mf", model(), lie=500, spaces=300), load_mesh, MeshError)
case("3MF packed in another way", packed("a.3mf", model(), how=zipfile.ZIP_BZIP2), load_mesh, MeshError)
laughs = "<!DOCTYPE m [<!ENTITY a0 'ha'>" + "".join(
    f"<!ENTITY a{n} '&a{n - 1};&a{n - 1};&a{n - 1};&a{n - 1};'>" for n in range(1, 30)) + "]>"  # fmt: skip
case("3MF of a billion laughs", packed("a.3mf", model(laughs, "<metadata>&a29;</metadata>")), load_mesh, MeshError)
doubling = "".join(component(n, n - 1, n - 1) for n in range(2, 40))
case("3MF of parts that double 38 times", packed("a.3mf", model(more=doubling, item=39)), load_mesh, MeshError)
case("3MF of a part in itself", packed("a.3mf", model(more=component(2, 2, 2), item=2)), load_mesh, MeshError)
chain = "".join(component(n, n - 1) for n in range(2, 100_000))
case("3MF of 100,000 parts in one another", packed("a.3mf", model(more=chain, item=99_999)), load_mesh, MeshError)

# slices
case("24 black slices of 11,500² pixels", black, slices, SliceError)
for kind, odd in ODD.items():
    case(f"{kind} among slices", among_slices(odd), slices, SliceError)
    in_place_of("a.sl1", slices, SliceError, kind)
pixel = png(4, 5)
case("zip that climbs", packed("a.zip", {"../s1.png": pixel}), slices, SliceError)
for what, odd_name in {"a number of 9,999 digits": f"s{'1' * 9999}.png", "an odd digit": "²5.png"}.items():
    case(f"zip with {what}", packed("a.zip", {odd_name: pixel, "s2.png": pixel}), slices, SliceError)
case("zip packed in another way", packed("a.zip", {"s1.png": pixel}, how=zipfile.ZIP_BZIP2), slices, SliceError)
case("zip that unpacks to more than it says", packed("a.zip", {"s1.png": b""}, lie=500, spaces=300), slices, SliceError)
case("slice cut off", packed("a.zip", {"s1.png": png(400, 500)[:-40]}), slices, SliceError)
huge = pixel[:16] + b"\xff" * 8 + pixel[24:]
case("slice of 4e9 pixels a row", packed("a.zip", {"s1.png": huge}), slices, SliceError)
case("SL1 that is an image", text("a.sl1", pixel), slices, SliceError)
case("zip whose list takes 23 MB", list_bomb, slices, SliceError)
case("nothing", lambda place: place / "none", slices, SliceError)
case("NUL", lambda place: place / "a\0b", slices, SliceError)

# NumPy's files
in_place_of("a.npy", map_npy, StorageError)
in_place_of("a.npz", read_npz, StorageError)
for what, words in {
    "of petabytes": npy("(1000000, 1000000, 1000)"), "of objects": npy("(2,)", "|O", b"cos\nsystem\n(S'false'\ntR."),
    "of a negative shape": npy("(-1, 3)"), "nested": npy("(" * 5000), "cut off": npy("(100,)", data=b"123"),
    "of no kind": npy("(1,)", "zz"), "of nothing": b"", "that is an image": pixel,
    "of version 9": b"\x93NUMPY\x09\x00" + bytes(99),
}.items():  # fmt: skip
    case(f"NPY {what}", text("a.npy", words), map_npy, StorageError)
    case(f"NPZ {what}", npz({"a.npy": words}), read_npz, StorageError)
case("NPZ bomb", packed("a.npz", {"a.npy": npy("(3000000000,)", "|u1")}, lie=3 * 10**9), read_npz, StorageError)

# patterns of other programs
in_place_of("a.sino", read_vamtoolbox, StorageError)
in_place_of("a.json", read_drtvam, StorageError)
in_place_of("a.mp4", read_film, StorageError)
SYSTEM = b"cposix\nsystem\n(S'touch harmed'\ntR."
for what, words in {
    "that runs a command": SYSTEM, "that runs one late": b"}(S'a'\n" + SYSTEM[:-1] + b"u.", "of nothing": b"",
    "of a place in memory far off": b"\x80\x04K\x01r\xff\xff\xff\x7f.", "of code": b"cbuiltins\neval\n(S'1'\ntR.",
    "of bytes by the terabyte": b"\x80\x04\x8e" + b"\xff" * 6 + b"\0\0.", "cut off": b"\x80\x04\x95\xff\0\0\0",
    "of a claim of memory": b"cbuiltins\nbytearray\n(L1000000000000L\ntR.", "that is a list": b"](K\x01K\x02e.",
    "nested": b"(" * 200_000 + b"t" * 200_000 + b".", "of a thing in itself": b"(lp0\ng0\na.",
    "of an array of objects": (
        b"cnumpy.core.multiarray\n_reconstruct\n(cnumpy\nndarray\n(I0\ntS'b'\ntR(I1\n(I2\ntcnumpy\ndtype\n"
        b"(S'O8'\nI0\nI1\ntR(I3\nS'|'\nNNNI-1\nI-1\nI63\ntbI00\n(lI1\naI2\natb."
    ),
    "of attributes of classes": b"c__builtin__\ngetattr\n(cvamtoolbox\nA\nS'x'\ntR.",
}.items():  # fmt: skip
    case(f"pickle {what}", text("a.sino", words), read_vamtoolbox, (StorageError, BadInput))
case("JSON 3000 deep", text("a.json", '{"vial":' + "[" * 3000), read_drtvam, (StorageError, BadInput))
case("JSON that is a list", text("a.json", "[1, 2]"), read_drtvam, BadInput)
case("JSON of half a set-up", text("a.json", '{"vial": {"medium": 3}, "projector": {}}'), read_drtvam, BadInput)
for what, words in {
    "that is an image": pixel, "of nothing": b"", "that is a playlist": b"#EXTM3U\n#EXTINF:1,\nfile:///etc/passwd\n",
    "cut off": b"\0\0\0\x18ftypmp42\0\0\0\0mp42isom", "of a box of exabytes": b"\0\0\0\1ftyp" + b"\xff" * 8 + b"moov",
}.items():  # fmt: skip
    case(f"film {what}", text("a.mp4", words), read_film, StorageError)
case("images of 4e9 pixels a row", lambda place: text("0.png", huge)(place).parent, pictures, StorageError)
case("images of several sizes", lambda place: [text(f"{n}.png", png(n, 4))(place) for n in (3, 4)][0].parent, pictures,
     BadInput)  # fmt: skip
case("folder without images", lambda place: place, pictures, BadInput)
case("EXR that is an image", lambda place: text("0.exr", pixel)(place).parent, pictures, StorageError)


def main(place: Path) -> None:
    """Read every file in a child of its own; a JSON line for each."""
    os.environ["VAMGPU_MEMORY"] = BUDGET
    warnings.simplefilter("ignore")
    import trimesh  # noqa: F401 - once, for all children
    import zarr  # noqa: F401

    load_mesh(text("warm.obj", BOX)(place))
    load_mesh(packed("warm.3mf", model())(place))
    frames(job(place))
    for number, (name, (make, read, error)) in enumerate(CASES.items()):
        folder = place / str(number)
        folder.mkdir()
        path = make(folder)
        before = int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
        back, front = os.pipe()
        child = os.fork()
        if child == 0:
            signal.alarm(PATIENCE)
            resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS))
            resource.setrlimit(resource.RLIMIT_AS, (40 << 30, 40 << 30))
            try:
                ended, said = "accepted", str(read(path))[:80]
            except error as found:
                ended, said = "typed", str(found)
            except BaseException as found:  # noqa: BLE001 - whatever else it is, it is wrong
                ended, said = type(found).__name__, str(found)
            os.write(front, json.dumps([ended, said[:2000]]).encode())
            os._exit(0)
        os.close(front)
        _, status, used = os.wait4(child, 0)
        with os.fdopen(back, "rb") as told:
            ended, said = json.loads(told.read() or f'["ended with status {status}", ""]')
        result = {"name": name, "ended": ended, "said": said, "work": used.ru_utime + used.ru_stime}
        print(json.dumps(result | {"memory": used.ru_maxrss * 1024 - before}), flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
