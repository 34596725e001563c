"""Sound files of every format that the library reads, and many ways to break them: each is read, or refused in words.

``python broken_files.py FOLDER ROUNDS [NAMES]`` breaks each file so often, or those whose name a pattern finds, and
prints a line for each file and for every way that ends otherwise.
"""

from __future__ import annotations

import json
import os
import pickle
import re
import resource
import signal
import struct
import sys
import tempfile
import time
import traceback
import warnings
import zipfile
from collections.abc import Callable
from importlib.util import find_spec
from io import BytesIO
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
from hostile_inputs import BUDGET, frames, job, npy, png

from vamgpu.calibration.pointspread import PointSpread
from vamgpu.chemistry.history import ResinHistory
from vamgpu.chemistry.materials.resin import Resin
from vamgpu.curethrough.resin import WorkingCurve, read_gray
from vamgpu.curethrough.spectrum import LampSpectrum
from vamgpu.curethrough.stack import layer_height, open_stack
from vamgpu.errors import VamError
from vamgpu.hosts.records.record import MAGIC, read_run
from vamgpu.hosts.rigs.config import EMULATED, read_rig
from vamgpu.jobs.curethrough import read_curethrough
from vamgpu.jobs.cuvettes import CuvetteJob
from vamgpu.jobs.demo import JOB
from vamgpu.jobs.foreign.drtvam import read_drtvam, read_task
from vamgpu.jobs.foreign.pictures import Layout, read_pictures
from vamgpu.jobs.foreign.vamtoolbox import read_vamtoolbox
from vamgpu.jobs.keys import EXAMPLES
from vamgpu.jobs.limits import read_limits
from vamgpu.jobs.read import read_job
from vamgpu.jobs.web import read_web
from vamgpu.printing.export import Canvas, export
from vamgpu.printing.frames import Frames
from vamgpu.printing.gray import GrayCurve
from vamgpu.scene import Scene
from vamgpu.storage.films import write_film
from vamgpu.storage.images import write_exr
from vamgpu.storage.numpy_files import map_npy, read_npz
from vamgpu.storage.tables import read_columns
from vamgpu.targets.mesh import load_mesh

SECONDS, MEMORY = 10, 1_000_000_000
NUMBERS = [*b"nan inf -1 0 1e999 1e-320 4294967295 99999999999999999999 1e30 x \xff".split(b" "), b""]
WORD = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?|[A-Za-z_]{3,}")
Reader = Callable[[Path], Any]
"""A reader is given the folder's file that was broken."""


def broken(data: bytes, chance: Random) -> bytes:
    """A file as disks, cables, editors and programs that stop midway leave it."""
    way, at = chance.randrange(9), chance.randrange(len(data) + 1)
    end = min(len(data), at + chance.choice((1, 4, 50, 1000)))
    if way == 0:
        return data[:at]
    if way == 1:
        return data[:at] + data[end:]
    if way == 2:
        return data[:end] + data[at:]
    if way == 3:
        return data[:at] + chance.randbytes(end - at) + data[end:]
    if way == 4:
        return data[:at] + chance.choice((b"\xff", b"\0", b"\x80", b"\x7f")) * min(4, end - at) + data[at + 4 :]
    if way == 5:
        return data + chance.choice((b"\0" * 50, b"\n", data[at:end], chance.randbytes(99)))
    words = list(WORD.finditer(data))
    if not words or way == 6:
        spot = chance.randrange(len(data) or 1)
        return data[:spot] + bytes((data[spot] ^ 1 << chance.randrange(8),)) + data[spot + 1 :] if data else b"\0"
    found = chance.choice(words)
    new = chance.choice(NUMBERS) if way == 7 else chance.choice(words).group()
    return data[: found.start()] + new + data[found.end() :]


def broken_zip(data: bytes, chance: Random) -> bytes:
    """A zip broken as a whole, or packed anew with one member that is broken, gone, or under another name."""
    if chance.random() < 0.3:
        return broken(data, chance)
    made = BytesIO()
    with zipfile.ZipFile(BytesIO(data)) as old, zipfile.ZipFile(made, "w", zipfile.ZIP_DEFLATED) as new:
        spoiled, way = chance.choice(old.namelist()), chance.randrange(8)
        for name in old.namelist():
            words = old.read(name)
            if name != spoiled:
                new.writestr(name, words)
            elif way:
                other = broken(name.encode(), chance).decode("latin-1") or "x"
                new.writestr(name if way > 1 else other, broken(words, chance))
    return made.getvalue()


def box(ending: str, **how: str) -> bytes:
    import trimesh

    made: Any = trimesh.creation.icosphere(1, 5.0).export(file_type=ending, **how)
    return made.encode() if isinstance(made, str) else made


def slices(path: Path) -> Any:
    with open_stack(path) as stack:
        return stack[0 : len(stack)], layer_height(stack)


def zipped(members: dict[str, bytes]) -> bytes:
    made = BytesIO()
    with zipfile.ZipFile(made, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in members.items():
            archive.writestr(name, data)
    return made.getvalue()


def picture(kind: str, **options: str) -> bytes:
    from PIL import Image

    made = BytesIO()
    Image.fromarray(np.arange(120, dtype=np.uint8).reshape(10, 12)).save(made, kind, **options)
    return made.getvalue()


def goo() -> bytes:
    """Two layers of 5 × 4 pixels."""
    head = bytearray(195_477)
    head[4:12] = b"\7\0\0\0DLP\0"
    struct.pack_into(">IHH", head, 195_310, 2, 5, 4)
    packed = bytes([0x08, 0x41, 99, 0x83, 0xC0 | 10])
    layer = b"\x55" + packed + bytes([~sum(packed) & 0xFF])
    return bytes(head) + 2 * (bytes(64) + b"\r\n" + struct.pack(">I", len(layer)) + layer + b"\r\n")


def ctb() -> bytes:
    """Two layers of 5 × 4 pixels, without a key."""
    packed = bytes([0x80, 9, 50, 0x80 | 127, 10])
    head = bytearray(112)
    struct.pack_into("<II", head, 0, 0x12FD0086, 2)
    struct.pack_into("<II", head, 52, 5, 4)
    struct.pack_into("<II", head, 64, 112, 2)
    rows = [struct.pack("<3f6I", 0.05, 2.0, 0.0, 184 + k * len(packed), len(packed), 0, 36, 0, 0) for k in (0, 1)]
    return bytes(head) + b"".join(rows) + 2 * packed


def sinogram() -> bytes:
    """A pickle of VAMToolbox, without its classes."""
    return pickle.dumps(np.arange(60.0, dtype=np.float32).reshape(3, 4, 5))


def film() -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        images = (np.full((16, 16, 3), 40 * k, np.uint8) for k in range(4))
        return write_film(Path(folder) / "a.mp4", images, 30.0).read_bytes()


def packages() -> bytes:
    """A 3MF package with components, two files, names, a beam lattice and words of PrusaSlicer."""
    corners = "".join(f'<vertex x="{x}" y="{y}" z="{z}"/>' for x in (0, 9) for y in (0, 9) for z in (0, 9))
    sides = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    faces = "".join(f'<triangle v1="{i}" v2="{a}" v3="{b}"/>' for i, j, k, m in sides for a, b in ((j, k), (k, m)))
    mesh = f"<mesh><vertices>{corners}</vertices><triangles>{faces}</triangles></mesh>"
    beams = '<b:beam v1="0" v2="1"/><b:beam v1="1" v2="3" r1="0.5" r2="0.8" cap1="butt" cap2="hemisphere"/>'
    balls = '<c:balls><c:ball vindex="1" r="2"/></c:balls>'
    lattice = f'<b:beamlattice radius="1" minlength="0.1" c:ballmode="mixed"><b:beams>{beams}</b:beams>{balls}'
    rods = f"<mesh><vertices>{corners}</vertices><triangles/>{lattice}</b:beamlattice></mesh>"
    spaces = (
        'unit="millimeter" xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02" '
        'xmlns:b="http://schemas.microsoft.com/3dmanufacturing/beamlattice/2017/02" '
        'xmlns:c="http://schemas.microsoft.com/3dmanufacturing/beamlattice/balls/2020/07" '
        'xmlns:p="http://schemas.microsoft.com/3dmanufacturing/production/2015/06" requiredextensions="p"'
    )
    part = '<component objectid="1" p:path="/3D/b.model" transform="1 0 0 0 1 0 0 0 1 2 3 4"/>'
    root = f'<object id="1" type="model">{mesh}</object><object id="2"><components>{part}</components></object>'
    root += f'<object id="3" name="insert rods">{rods}</object>'
    items = '<item objectid="1"/><item objectid="2" printable="1" transform="2 0 0 0 2 0 0 0 2 30 0 0"/>'
    items += '<item objectid="3"/>'
    words = '<metadata type="volume" key="volume_type" value="ModelPart"/>'
    return zipped({
        "3D/3dmodel.model": f"<model {spaces}><resources>{root}</resources><build>{items}</build></model>".encode(),
        "3D/b.model": f'<model {spaces}><resources><object id="1">{mesh}</object></resources><build/></model>'.encode(),
        "Metadata/Slic3r_PE_model.config": f'<config><object id="1"><volume firstid="0" lastid="11">{words}</volume>'
                                           "</object></config>".encode(),
    })  # fmt: skip


def exported(place: Path) -> dict[str, bytes]:
    """Images of `vam export --png` and their description, first."""
    levels = np.arange(60, dtype=np.uint8).reshape(4, 5, 3)
    packed = Frames.from_bytes(levels, "numpy", bits=8, gray=GrayCurve.gamma(2.2), scale=1.0, columns=3)
    folder = export(packed, place / "exported", canvas=Canvas((9, 8), repeats=2))
    return {file.name: file.read_bytes() for file in sorted(folder.iterdir(), key=lambda file: file.suffix != ".json")}


def exr() -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        write_exr(Path(folder) / "a.exr", np.linspace(0.0, 2.0, 20, dtype=np.float32).reshape(4, 5))
        return (Path(folder) / "a.exr").read_bytes()


DRTVAM: dict[str, Any] = {
    "vial": {"type": "cylindrical", "r_int": 7, "r_ext": 8, "ior": 1.54,
             "medium": {"ior": 1.4, "extinction": 0.1, "albedo": 0.0}},
    "projector": {"type": "collimated", "n_patterns": 4, "resx": 6, "resy": 5, "pixel_size": 0.5, "motion": "circular"},
    "sensor": {"type": "dda", "scalex": 6, "scaley": 6, "scalez": 4, "film": {"resx": 12, "resy": 12, "resz": 8}},
    "target": {"filename": "part.stl", "size": 4.0, "box_center_x": 0.75},
    "loss": {"type": "threshold", "tl": 0.9, "tu": 0.95}, "n_steps": 40,
}  # fmt: skip
CURVE = b"exposure_mJ_cm2,height_mm\n" + b"".join(
    b"%d,%.3f\n" % (x, 0.2 * np.log10(x / 5)) for x in (9, 20, 40, 90, 200)
)
GRAY = b"level,intensity_mW_cm2\n" + b"".join(b"%d,%.2f\n" % (x, x / 20) for x in range(0, 256, 15))


SOUND: dict[str, tuple[dict[str, bytes], Reader]] = {}
"""A name → files, of which the first is broken, and what reads that one."""


def sound(name: str, read: Reader, data: bytes, file: str, **others: bytes) -> None:
    SOUND[name] = ({file: data} | {other.replace("_", ".", 1): held for other, held in others.items()}, read)


def sound_files(place: Path) -> None:
    """Fill `SOUND`; ``place`` is a folder for files that only the library makes."""
    part = box("stl")
    for name, ending, data in (
        ("STL", "stl", part), ("ASCII STL", "stl", box("stl_ascii")), ("PLY", "ply", box("ply")),
        ("ASCII PLY", "ply", box("ply", encoding="ascii")), ("OBJ", "obj", box("obj")), ("3MF", "3mf", packages()),
    ):  # fmt: skip
        sound(name, load_mesh, data, f"a.{ending}")
    pictures = {f"s{n}.png": png(4, 5) for n in range(3)}
    config = b"layerHeight = 0.05\nnumFast = 3\nexpTime = 8\n"
    sound("zip of slices", slices, zipped(pictures), "a.zip")
    sound("SL1", slices, zipped({"config.ini": config, **pictures}), "a.sl1")
    sound("goo", slices, goo(), "a.goo")
    sound("ctb", slices, ctb(), "a.ctb")
    for ending, data in (("png", picture("PNG")), ("tif", picture("TIFF", compression="tiff_lzw"))):
        sound(f"{ending} slice", lambda file: slices(file.parent), data, f"s1.{ending}")
        sound(f"{ending} pattern", lambda file: read_pictures(file.parent, Layout()), data, f"1.{ending}")
    npz = zipped({"patterns.npy": npy("(4, 5, 6)", "|u1", bytes(range(120)))})
    sound("patterns alone", lambda file: read_pictures(file, Layout()), npz, "a.npz")
    sound("film", lambda file: read_pictures(file, Layout()), film(), "a.mp4")
    sound("roles in names", lambda file: Scene.from_3mf(file, roles="names"), packages(), "a.3mf")
    SOUND["exported images"] = (exported(place), lambda file: read_pictures(file.parent, Layout()))
    if find_spec("OpenEXR"):
        sound("EXR pattern", lambda file: read_pictures(file.parent, Layout()), exr(), "1.exr")
    array = npy("(3, 4, 5)", "<f4", np.arange(60, dtype="<f4").tobytes())
    sound("NPY", lambda file: np.array(map_npy(file)), array, "a.npy")
    sound("NPZ", read_npz, zipped({"patterns.npy": array, "scale.npy": array}), "a.npz")
    sound("sinogram", read_vamtoolbox, sinogram(), "a.sino")
    sound("NPY sinogram", read_vamtoolbox, array, "a.npy")
    sound("target", lambda file: read_vamtoolbox(file.parent / "a.sino", file), sinogram(), "b.pkl", a_sino=sinogram())
    drtvam = json.dumps(DRTVAM).encode()
    patterns = zipped({"patterns.npy": npy("(4, 5, 6)", "<f4", np.ones(120, "<f4").tobytes())})
    sound("Dr.TVAM", read_drtvam, drtvam, "a.json", patterns_npz=patterns, part_stl=part)
    sound("Dr.TVAM's task", read_task, drtvam, "a.json", part_stl=part)
    square = DRTVAM | {
        "vial": {"type": "square", "w_int": 8, "w_ext": 9, "ior": 1.5, "medium": DRTVAM["vial"]["medium"]}
    }
    sound("its square vial", read_task, json.dumps(square).encode(), "a.json", part_stl=part)
    preset = {
        "stl_path": "part.stl",
        "part_height_mm": 9.0,
        "vial_radius_mm": 12.0,
        "throw_ratio": 2.0,
        "diffusion": True,
    }
    sound("preset", read_task, json.dumps(preset).encode(), "a.json", part_stl=part)
    beside = {"a_json": drtvam, "part_stl": part}
    sound("its patterns", lambda file: read_drtvam(file.parent / "a.json"), patterns, "patterns.npz", **beside)
    sound("table", read_columns, CURVE, "a.csv")
    sound("working curve", lambda file: WorkingCurve.read(file, 0.1), CURVE, "a.csv")
    sound("lamp", LampSpectrum.read, b"light;absorption\n1;0.5\n2;0.25\n", "a.csv")
    sound("gray levels", read_gray, GRAY, "a.csv")
    for name, read, text in (
        ("job", read_job, JOB), ("web", read_web, EXAMPLES["web"]), ("limits", read_limits, EXAMPLES["machine"]),
        ("slices' job", read_curethrough, EXAMPLES["slices"]), ("rig", read_rig, EMULATED),
        ("cuvettes", CuvetteJob.read,
         '[cuvette]\nwidth = "10 mm"\nwall = "1 mm"\nresin_index = 1.48\nwall_index = 1.52\nbeam = "1 mm"\n'
         'screen = "25 mm"\npixel = "0.25 mm"\nhole = "6 mm"\ndark = 9.0\nerror = "2 %"\n'
         '[[sample]]\nthickness = "1 mm"\ncollimated = 0.5\ntotal = 0.8\n'),
        ("gray curve", GrayCurve.load, "[gray]\nlevels = [0, 100, 255]\nintensity = [0.0, 3.0, 10.0]\n"),
        ("spread", lambda file: PointSpread.load(file, 0.01),
         'calibration = "mtf"\n[measured]\npositions_mm = [-1.0, 0.0, 1.0]\nblur_mm = [0.02, 0.01, 0.02]\n'
         "pixel_mm = 0.005\n"),
    ):  # fmt: skip
        sound(name, read, text.encode(), "result.toml")
    data = Path(sys.modules[Resin.__module__].__file__ or "").parent / "data/resins/bisgma-tegdma-habi.toml"
    sound("resin", Resin.load, data.read_bytes(), "a.toml")
    ResinHistory("a", 30.0).printed(spent=0.3, lost=0.1).save(place / "h.json")
    sound("history", ResinHistory.load, (place / "h.json").read_bytes(), "a.json")
    folder = job(place)
    for name in ("manifest.json", "frames/zarr.json", "frames/c/0/0/0"):
        files = {name: (folder / name).read_bytes()}
        files |= {str(f.relative_to(folder)): f.read_bytes() for f in folder.rglob("*") if f.is_file()} | files
        SOUND[name] = (dict(sorted(files.items(), key=lambda item: item[0] != name)), _inside(name))
    run = {
        "run.json": b"{}",
        "state.json": b'{"state": "complete", "message": ""}',
        "events.jsonl": b"",
        "shown.bin": MAGIC,
    }
    for name in ("run.json", "state.json", "shown.bin"):
        SOUND[name] = ({name: run[name]} | run, lambda file: read_run(file.parent))


def _inside(name: str) -> Reader:
    return lambda file: frames(file.parents[name.count("/")])


class Late(BaseException):
    """A reader took too long."""


def late(*_: object) -> None:
    raise Late


def main(place: Path, rounds: int, names: str = "") -> None:
    """Break every file, read it, and print what ended as neither a result nor an error of the library."""
    os.environ["VAMGPU_MEMORY"] = BUDGET
    warnings.simplefilter("ignore")
    sound_files(place)
    signal.signal(signal.SIGALRM, late)
    for name, (files, read) in SOUND.items():
        if not re.search(names, name):
            continue
        file = place / name.replace("/", "-") / next(iter(files))
        for path, data in reversed(files.items()):
            held = place / name.replace("/", "-") / path
            held.parent.mkdir(parents=True, exist_ok=True)
            held.write_bytes(data)
        read(file)  # it is sound
        room = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE") + MEMORY
        resource.setrlimit(resource.RLIMIT_AS, (room, resource.RLIM_INFINITY))
        data, ends = next(iter(files.values())), {"read": 0, "refused": 0}
        spoil = broken_zip if data[:2] == b"PK" else broken
        began = time.process_time()
        for seed in range(rounds):
            file.write_bytes(spoil(data, Random(f"{name} {seed}")))
            signal.alarm(SECONDS)
            try:
                read(file)
                ends["read"] += 1
            except VamError as error:
                ends["refused"] += 1
                if len(str(error)) < 20 or "MemoryError" in str(error):
                    print(json.dumps({"name": name, "seed": seed, "error": str(error)}), flush=True)
            except BaseException as error:  # noqa: BLE001 - whatever else it is, it is wrong
                where = traceback.extract_tb(error.__traceback__)[-1]
                wrong = f"{type(error).__name__}: {error} at {where.filename}:{where.lineno}"
                print(json.dumps({"name": name, "seed": seed, "error": wrong}), flush=True)
            finally:
                signal.alarm(0)
        print(json.dumps({"name": name, **ends, "seconds": round(time.process_time() - began, 2)}), flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]), *sys.argv[3:])
