"""A server that answers as the API of Studio does, from examples, without solving: for the page in states that take long."""

from __future__ import annotations

import io
import json
import queue
import re
import threading
import time
import tomllib
from collections.abc import Iterator
from functools import cache
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, unquote, urlsplit

import numpy as np
from PIL import Image
from scipy.ndimage import gaussian_filter
from skimage.measure import marching_cubes

STATIC = Path(__file__).resolve().parent.parent / "vamgpu" / "studio" / "static"
TYPES = {".html": "text/html", ".js": "text/javascript", ".css": "text/css", ".woff2": "font/woff2", ".svg": "image/svg+xml", ".txt": "text/plain"}
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; font-src 'self'; "
    "worker-src 'self'; frame-src 'self'; base-uri 'none'; form-action 'none'"
)
TEXT = """\
# Boat for the catalog
[target]
mesh = "benchy.stl"
height = "11.5 mm"     # without a pitch, voxels are as wide as a pixel in the resin

[vial]
radius = "12.4 mm"     # measured with a caliper
wall = "1 mm"
resin_index = 1.49962
wall_index = 1.473
absorption = "0.05 /mm"

[beam]
pixels = [360, 300]
pitch = "67 um"
fill = 0.92
spread = "25 um"

[print]
irradiance = "65 mW/cm2"
critical_dose = "50 mJ/cm3"
"""
PITCH = 0.15  # mm
VERDICT = {
    "prints": True, "proved": True, "opening": "Prints", "remedies": [], "latitude": [0.9, 1.099], "not_judged": [],
    "sentence": "Prints: 1 body and 8 holes as in the part, 95 % of the surface within 19.8 µm; the dose may be 10 % "
    "lower to 9.9 % higher; 22.7 s.",
}  # fmt: skip
NOT = VERDICT | {
    "prints": False, "opening": "Does not print", "latitude": None,
    "sentence": "Does not print: 2 of 8 holes are closed; stray resin prints 1.2 mm above the part.",
    "remedies": ["180 angles instead of 60", "120 evaluations instead of 20: the window still grew by 0.004 in each"],
}  # fmt: skip


@cache
def volumes() -> tuple[np.ndarray, np.ndarray]:
    """A ring on a plate, with a peg at +x, +y [x, y, z], and a dose that prints them."""
    x, y, z = np.meshgrid(*(PITCH * (np.arange(n) - n / 2 + 0.5) for n in (96, 96, 64)), indexing="ij")
    ring = (np.abs(np.hypot(x, z) - 2.6) < 0.9) & (np.abs(y) < 1.2)
    plate = (np.abs(z + 3.3) < 0.7) & (np.hypot(x, y) < 4.8)
    peg = (np.abs(x - 3.6) < 0.6) & (np.abs(y - 2.4) < 0.6) & (np.abs(z + 2) < 1.2)
    part = (ring | plate | peg).astype(np.float32)
    soft = gaussian_filter(part, 1.2)
    glow = 0.35 + 0.2 * gaussian_filter(part, 9) + 0.02 * np.sin(3 * x) * np.cos(2 * y)
    return part, np.clip(glow + 0.92 * soft, 0, 1.5).astype(np.float32)


@cache
def surface(of: str) -> dict[str, np.ndarray]:
    """Surface of the target or the print [mm], with a deviation at each vertex."""
    part, dose = volumes()
    field, level = (part, 0.5) if of == "target" else (dose, 1.0)
    points, faces, normals, _ = marching_cubes(gaussian_filter(field, 0.6), level, spacing=(PITCH,) * 3)
    points = points - PITCH * (np.array(field.shape) - 1) / 2
    deviation = 0.1 * np.sin(1.3 * points[:, 0]) * np.cos(1.7 * points[:, 2])
    arrays = {"positions": points, "normals": normals, "deviation": deviation}
    return {k: v.astype(np.float32) for k, v in arrays.items()} | {"indices": faces.astype(np.uint32)}


def png(image: np.ndarray) -> bytes:
    out = io.BytesIO()
    Image.fromarray(image.astype(np.uint8)).save(out, "PNG")
    return out.getvalue()


def task(kind: str = "solve", state: str = "running", **changed: Any) -> dict[str, Any]:
    """A task of the queue."""
    now = time.time()
    progress = {
        "stage": "light", "said": "optimizing the patterns", "share": 0.31, "left": 42.0, "iteration": 37,
        "evaluations": 37.0, "loss": 0.0123, "window": 0.083, "warnings": [], "wall": now, "slices": 3,
        "stages": [{"stage": "voxels", "said": "voxelizing the part", "seconds": 1.2},
                   {"stage": "rays", "said": "tracing rays through the vial", "seconds": 3.4}],
        "notes": ["about 1.2 GB of memory, 120 evaluations of 0.3 s: about 40 s in all"],
    }  # fmt: skip
    made = {
        "id": f"20261127-19150{len(kind)}-{kind}", "kind": kind, "job": "boat.toml", "result": "boat.vam", "rig": None,
        "run": None, "device": None, "state": state, "added": now - 20, "began": now - 18, "ended": None,
        "status": None, "message": "", "resumable": False, "made": [], "request": {}, "progress": progress,
    }  # fmt: skip
    return made | changed


def _key(name: str, kind: str, doc: str, default: str = "", **more: Any) -> dict[str, Any]:
    """A key of a table; one with a unit is a quantity above 0."""
    unit = more.get("unit", "")
    what = f"a value > 0 {unit}" if unit else {"count": "a whole number ≥ 1", "number": "a number"}.get(kind, "text")
    made = {
        "name": name, "type": "quantity" if unit else kind, "what": what, "unit": unit, "units": [unit], "least": None,
        "above": 0.0, "most": None, "below": None, "choices": [], "required": False, "default": default, "doc": doc,
    }  # fmt: skip
    return made | more


def schema() -> dict[str, Any]:
    """Some tables of job files."""

    def table(name: str, doc: str, *keys: dict[str, Any], optional: bool = True, **more: Any) -> dict[str, Any]:
        made = {"name": name, "doc": doc, "optional": optional, "many": False, "component": "", "kinds": [], "word": "kind"}
        return made | {"keys": list(keys)} | more

    tolerant = _key("tolerance", "number", "share of the first loss at which to stop", "0")
    return {
        "tables": [
            table("target", "The part: a mesh file or a bundled shape, its size and its voxels.",
                  _key("mesh", "file", "file of the part (STL, PLY, OBJ, 3MF)"),
                  _key("height", "length", "height of the part along z", unit="mm"),
                  _key("pitch", "length", "edge of a voxel; by default the width of a pixel in the resin", unit="mm"),
                  _key("orientation", "list", "3 × 3 matrix that rotates the part first"), optional=False),
            table("vial", "A round vial in air or in a bath of liquid.",
                  _key("radius", "length", "outer radius", unit="mm", required=True),
                  _key("wall", "length", "thickness of the wall", unit="mm", required=True),
                  _key("resin_index", "number", "refractive index of the resin", required=True),
                  _key("wall_index", "number", "refractive index of the wall", required=True),
                  _key("bath_index", "number", "refractive index of what surrounds the vial", "1"),
                  _key("absorption", "absorption", "absorption of the resin", '"0 1/mm"', unit="1/mm")),
            table("beam", "The projector's light.",
                  _key("pitch", "length", "edge of a pixel in air", unit="mm", required=True),
                  _key("pixels", "list", "columns and rows; by default as many as the part needs"),
                  _key("fill", "number", "share of a pixel's area that is lit", "1"),
                  _key("spread", "any", "standard deviation of the point spread; by default half a pixel"),
                  _key("footprint", "choice", "how a pixel covers a voxel", '"exact"', choices=["exact", "joseph"]),
                  optional=False),
            table("print", "Lamp and resin, for predicting print times.",
                  _key("irradiance", "irradiance", "irradiance of a full-on pixel in air", unit="mW/mm2", required=True),
                  _key("critical_dose", "dose", "dose at which the resin solidifies", unit="J/cm3", required=True)),
            table("solve", "Settings of the optimization.", _key("iterations", "count", "total number of iterations"), tolerant),
            table("method", "How the patterns are found.", kinds=["method.bclp", "method.osmo"]),
            table("body", "One of several bodies.", many=True),
        ],
        "components": {"method.bclp": {"doc": "Band-constrained Lp norm.", "keys": [tolerant]}, "method.osmo": {"doc": "OSMO.", "keys": []}},
    }  # fmt: skip


def result(verdict: dict[str, Any] | None = VERDICT) -> dict[str, Any]:
    """A result, proved if it has a verdict."""
    steps = list(range(1, 41))
    lines = [
        ("process window, strict", "+0.0712", "least dose in the part minus the greatest outside, in thresholds"),
        ("voxels missing", "0", "of the part, that stay liquid"), ("voxels in excess", "3", "beside the part, that solidify"),
        ("mean brightness", "3.4 %", "of the frames, relative to a full-on pixel"),
    ]  # fmt: skip
    row = {"name": "as designed", "change": "", "window": 0.071, "wrong": 0, "note": ""}
    shifted = [("axis of rotation", f"{k * 20} µm", 0.071 - 0.02 * k, 3 * k) for k in (1, 2)]
    rows = [row, *({"name": n, "change": c, "window": w, "wrong": k, "note": ""} for n, c, w, k in shifted)]
    first = [{"name": "axis of rotation", "amount": 0.05, "text": "first wrong voxel at 52 µm"}]
    return {
        "id": "boat.vam", "state": "proved" if verdict else "solved", "job": "boat.toml", "modified": time.time(),
        "verdict": verdict, "lines": [dict(zip(("name", "value", "meaning"), each, strict=True)) for each in lines],
        "scores": {"window": 0.0712, "iou": 0.9991, "threshold": 0.81, "peak": 1.32, "missing": 0, "excess": 3,
                   "in_voxels": 1, "out_voxels": 2} if verdict else None,
        "seconds": 22.7 if verdict else None, "pitch": PITCH, "shape": [96, 96, 64], "radius": 5.7,
        "outer": {"share": 0.42, "where": "above the part", "place": [0, 0, 4]} if verdict else None,
        "tolerances": {"nominal": row, "rows": rows, "first": first} if verdict else None,
        "frames": {"count": 36, "rows": 64, "columns": 96, "bits": 8, "scale": 1.1},
        "history": {"iteration": steps, "evaluations": steps, "loss": [0.1 / k for k in steps], "window": [0.09 - 0.3 / k for k in steps]},
        "exposed": [{"off": {"axis": "20 um"}, "proof": "boat@axis-20um.proof"}] if verdict else [],
        "report": "/api/v1/results/boat.vam/report" if verdict else None,
    }  # fmt: skip


class Studio:
    """The server; a context manager. ``answers`` replaces what a GET of a path yields; ``posts`` has what was sent."""

    def __init__(self, **changed: Any) -> None:
        self.text, self.version = TEXT, 1
        self.tasks: list[dict[str, Any]] = changed.pop("tasks", [])
        self.result: dict[str, Any] | None = changed.pop("result", result())
        self.empty: bool = changed.pop("empty", False)
        self.answers: dict[str, Any] = changed
        self.posts: list[tuple[str, str, Any]] = []
        self.streams: list[queue.Queue[str]] = []

    def __enter__(self) -> Studio:
        studio = self

        class Handler(_Handler):
            owner = studio

        self.server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.server.daemon_threads = True
        self.url = f"http://127.0.0.1:{self.server.server_address[1]}/"
        threading.Thread(target=self.server.serve_forever, daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        for stream in self.streams:
            stream.put("")
        self.server.shutdown()
        self.server.server_close()

    def tell(self, event: str, data: Any) -> None:
        """Send an event to every page."""
        for stream in self.streams:
            stream.put(f"id: A-{time.monotonic_ns()}\nevent: {event}\ndata: {json.dumps(data)}\n\n")

    def check(self, text: str) -> dict[str, Any]:
        """Fields and errors of a text; a radius below the wall is wrong, as any text that is no TOML."""
        try:
            fields = tomllib.loads(text)
        except tomllib.TOMLDecodeError as error:
            return {"text": text, "fields": {}, "errors": [{"field": "", "line": 1, "message": str(error)}]}
        radius, errors = str(fields.get("vial", {}).get("radius", "1 mm")), []
        if not re.fullmatch(r"[\d.]+ (mm|um|cm)", radius):
            line = next(n for n, each in enumerate(text.splitlines(), 1) if each.startswith("radius"))
            message = f'got radius = "{radius}"; expected a length above 0 mm, such as "12.4 mm"'
            errors = [{"field": "vial.radius", "line": line, "message": message}]
        return {"text": text, "fields": fields, "errors": errors}

    def edit(self, body: dict[str, Any]) -> dict[str, Any]:
        """Replace or add lines of a text; comments stay."""
        lines = body["text"].splitlines()
        for key, value in [*body["set"].items(), *((key, None) for key in body["remove"])]:
            table, _, name = key.rpartition(".")
            lines = list(_edited(lines, table or key, name if table else None, value))
        return self.check("\n".join(lines) + "\n")

    def job(self) -> dict[str, Any]:
        return {"id": "boat.toml", "etag": str(self.version), **self.check(self.text)}

    def workspace(self) -> dict[str, Any]:
        now, empty = time.time(), {"parts": [], "jobs": [], "results": []}
        state = "new" if self.result is None else self.result["state"]
        made = None if self.result is None else "boat.vam"
        error = self.check(self.text)["errors"]
        listed = {
            "parts": [{"id": "benchy.stl", "bytes": 11285384, "modified": now}],
            "jobs": [{"id": "boat.toml", "modified": now, "kind": "vial", "part": "benchy.stl", "result": made,
                      "state": "invalid" if error else state, "error": ""}],
            "results": [] if self.result is None else [
                {"id": name, "modified": now, "job": job, "bytes": 81233, "state": self.result["state"],
                 "verdict": self.result["verdict"]} for name, job in (("boat.vam", "boat.toml"), ("boat-60.vam", None))],
        }  # fmt: skip
        return {
            "name": "vamgpu-studio", "revision": 17, "opened": None, **(empty if self.empty else listed),
            "rigs": [{"id": "emulated"}, {"id": "lab.toml"}], "trash": 0,
        }  # fmt: skip


def _edited(lines: list[str], table: str, name: str | None, value: Any) -> Iterator[str]:
    inside = done = False
    for line in lines:
        if line.startswith("["):
            if inside and not done and value is not None:
                yield f"{name} = {json.dumps(value)}"
                done = True
            inside = line.strip("[] ") == table
        if inside and (name is None or re.match(rf"{name}\s*=", line)):
            done = True
            if value is None:
                continue
            comment = line[line.index("#") :] if "#" in line else ""
            line = f"{name} = {json.dumps(value)}  {comment}".rstrip()
        yield line
    if value is not None and not done:
        yield from ([] if inside else [f"\n[{table}]"]) + [f"{name} = {json.dumps(value)}"]


class _Handler(BaseHTTPRequestHandler):
    owner: Studio
    protocol_version = "HTTP/1.1"

    def log_message(self, *_: Any) -> None:
        """No output."""

    def reply(self, body: bytes, kind: str = "application/json", status: int = 200, **headers: str) -> None:
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(body)))
        self.send_header("Content-Security-Policy", POLICY)
        for name, value in headers.items():
            self.send_header(name.replace("_", "-"), value)
        self.end_headers()
        self.wfile.write(body)

    def json(self, data: Any, status: int = 200) -> None:
        self.reply(json.dumps(data).encode(), status=status)

    def arrays(self, named: dict[str, np.ndarray], **meta: float) -> None:
        described = [{"name": k, "dtype": str(v.dtype), "shape": v.shape} for k, v in named.items()]
        body = b"".join(v.tobytes() + b"\0" * (-v.nbytes % 4) for v in map(np.ascontiguousarray, named.values()))
        self.reply(body, "application/octet-stream", X_Arrays=json.dumps(described), X_Meta=json.dumps(meta))

    def refuse(self, status: int, message: str) -> None:
        self.json({"error": {"message": message, "fields": []}}, status)

    def do_GET(self) -> None:  # noqa: N802
        place = urlsplit(self.path)
        path, query = unquote(place.path), {k: v[0] for k, v in parse_qs(place.query).items()}
        if path == "/" or path.startswith("/static/"):
            file = STATIC / (path.removeprefix("/static/") if path != "/" else "index.html")
            return self.reply(file.read_bytes(), TYPES[file.suffix]) if file.is_file() else self.refuse(404, path)
        name = path.removeprefix("/api/v1/")
        if name == "events":
            return self.stream()
        if name in self.owner.answers:
            return self.json(self.owner.answers[name])
        if name.startswith("results/"):
            return self.results(name, query)
        if name.endswith(("/mesh", "/slice")):
            return self.pieces(name)
        found = self.known(name)
        return self.refuse(404, f"no {name}") if found is None else self.json(found)

    def known(self, name: str) -> Any:
        owner, steps = self.owner, list(range(1, 38))
        if match := re.fullmatch(r"tasks/([\w-]+)", name):
            history = {"evaluations": steps, "window": [0.09 - 0.4 / k for k in steps], "loss": [1 / k for k in steps]}
            return next((each | {"history": history} for each in owner.tasks if each["id"] == match[1]), None)
        part = {"id": "benchy.stl", "bytes": 11285384, "modified": 0.0, "triangles": 225706, "unit": "mm", "doubts": [],
                "low": [-30.0, -15.5, 0.0], "high": [30.0, 15.5, 48.0], "extents": [60.0, 31.0, 48.0]}  # fmt: skip
        return {
            "workspace": owner.workspace, "jobs/boat.toml": owner.job, "parts/benchy.stl": lambda: part,
            "tasks": lambda: {"tasks": owner.tasks}, "schema": schema, "jobs/boat.toml/scene": scene,
            "presets": presets, "print": lambda: {"run": None, "state": None, "page": "/print/"},
            "devices": lambda: {"devices": [{"name": "pocl", "description": "PoCL, two cores"}], "ready": True},
            "runs": runs, "rigs/emulated": rig, "rigs/lab.toml": rig, "compare": compared,
        }.get(name, lambda: None)()  # fmt: skip

    def pieces(self, name: str) -> None:
        part, dose = volumes()
        if name.endswith("slice"):
            middle = {"dose": dose[:, 48].T[::-1], "target": (part[:, 48].T[::-1] > 0.5).astype(np.uint8)}
            return self.arrays(middle)
        made = surface("target")
        points = made["positions"] * np.float32(1.0 if name.startswith("jobs") else 5.0)
        if not name.startswith("jobs"):
            points = points + np.float32([0, 0, 24])
        named = {"positions": points, "indices": made["indices"]}
        return self.arrays(named, triangles=len(made["indices"]), shown=len(made["indices"]), cell=0)

    def results(self, name: str, query: dict[str, str]) -> None:
        _, _, what = name.split("/", 2) if name.count("/") > 1 else (*name.split("/"), "")
        part, dose = volumes()
        if not what:
            return self.refuse(404, "no such result") if self.owner.result is None else self.json(self.owner.result)
        if what == "volume":
            of = part if query["of"] == "target" else dose
            full = 1.0 if query["of"] == "target" else 1.5
            values = np.round(255 * of / full).astype(np.uint8).transpose(2, 1, 0)
            low = dict(zip(("left", "bottom", "low"), (-PITCH * n / 2 for n in part.shape), strict=True))
            return self.arrays({"values": values}, pitch=PITCH, full=full, **low)
        if what == "surface" and query["of"] == "stray":
            return self.refuse(404, "no stray resin")
        if what == "surface":
            return self.arrays(surface(query["of"]), pitch=PITCH)
        if what == "exposure":
            solid = dose * float(query["dose"]) >= 1
            missing, excess = int((part.astype(bool) & ~solid).sum()), int((solid & ~part.astype(bool)).sum())
            return self.json({"dose": float(query["dose"]), "missing": missing, "excess": excess, "iou": 0.98, "seconds": 23.0})
        if what in ("frame", "sinogram"):
            angle = int(query.get("index", 0)) * np.pi / 18
            flat = 140 * part.max(0 if abs(np.cos(angle)) > 0.7 else 1).T[::-1]
            return self.reply(png(flat + 60 * gaussian_filter(flat / 140, 3)), "image/png")
        return self.refuse(404, what)

    def stream(self) -> None:
        events: queue.Queue[str] = queue.Queue()
        self.owner.streams.append(events)
        self.send_response(200)
        self.send_header("Content-Type", "text/event-stream")
        self.end_headers()
        self.close_connection = True
        try:
            self.wfile.write(b"id: A-1\nevent: reset\ndata: {}\n\n")
            while text := events.get():
                self.wfile.write(text.encode())
                self.wfile.flush()
        except OSError:
            pass

    def body(self) -> Any:
        raw = self.rfile.read(int(self.headers.get("Content-Length") or 0))
        return json.loads(raw) if "json" in self.headers.get("Content-Type", "") else raw

    def do_POST(self) -> None:  # noqa: N802
        name, body, owner = unquote(urlsplit(self.path).path).removeprefix("/api/v1/"), self.body(), self.owner
        owner.posts.append((self.command, name, body))
        if name == "jobs/edit":
            return self.json(owner.edit(body))
        if name == "tasks":
            made = task(body["kind"], "queued", request=body, progress=None, id=f"{len(owner.tasks)}-{body['kind']}")
            owner.tasks.insert(0, made)
            return self.json(made, 201)
        if match := re.fullmatch(r"tasks/(.+)/cancel", name):
            made = next(each for each in owner.tasks if each["id"] == match[1])
            made.update(state="cancelled", resumable=True, message="cancelled after 37 evaluations")
            return self.json(made)
        return self.json(owner.job(), 201)

    def do_PUT(self) -> None:  # noqa: N802
        body, owner = self.body(), self.owner
        owner.posts.append((self.command, self.path, body))
        if body.get("etag") != str(owner.version):
            return self.refuse(409, "the file changed")
        owner.text, owner.version = body["text"], owner.version + 1
        return self.json(owner.job())

    do_DELETE = do_POST  # noqa: N815


def scene() -> dict[str, Any]:
    return {
        "vessel": {"table": "vial", "kind": "vial", "shape": "cylinder", "radius": 12.4, "inner": 11.4, "lit": 9.8},
        "part": {"triangles": 225706, "low": [-5, -4.8, -4], "high": [5, 4.8, 3.5], "extents": [9.6, 9.6, 7.5], "radius": 4.9},
        "grid": {"shape": [256, 256, 178], "pitch": 0.045, "radius": 9.8}, "problems": [], "doubts": [], "memory": 2.1e9,
        "beam": {"pixels": [360, 300], "pitch": 0.067, "width": 21.0, "height": 12.1, "reach": 8.9},
    }  # fmt: skip


def presets() -> dict[str, Any]:
    def one(name: str, source: str, **values: Any) -> dict[str, Any]:
        return {"id": name.lower().replace(" ", "-"), "name": name, "source": source, "own": not source, "set": values}

    vial = {"vial.radius": "12.4 mm", "vial.wall": "1 mm"}
    return {
        "vials": [one("Vial of 25 mm", "D. Loterie et al., 2020", **vial), one("our small vial", "", **{"vial.radius": "8 mm"})],
        "projectors": [one("360 × 300 pixels of 67 µm", "the README", **{"beam.pitch": "67 um", "beam.pixels": [360, 300]})],
        "resins": [one("dudma-pegda", "J. Smith et al., 2022", **{"resin.material": "dudma-pegda"})],
    }  # fmt: skip


def rig() -> dict[str, Any]:
    claims = [
        ("light", "guaranteed", "the controller closes the light 1 s after its host falls silent", None),
        ("motion", "watched", "an encoder reports the angle; a stall holds the print", None),
        ("dose", "believed", "no sensor sees the lamp", "calibrate it with vam calibrate power"),
    ]
    rows = [{"about": a, "kind": k, "why": w, "remedy": r, "sensor": "", "holds": k != "believed"} for a, k, w, r in claims]
    return {"id": "emulated", "machine": "vial", "parts": {}, "guarantees": rows, "refused": "", "emulated": True}


def runs() -> dict[str, Any]:
    done = {"name": "boat.run", "job": "boat.vam", "state": "complete", "message": "", "began": time.time() - 4000}
    held = {"name": "boat-2.run", "job": "boat.vam", "state": "error", "message": "the motor stalled at 212.8 deg; look at its cable", "began": time.time() - 90000}  # fmt: skip
    more: dict[str, Any] = {"seconds": 214.0, "doubt": 0, "running": False, "reports": ["report.html"]}
    return {"runs": [done | more, held | more | {"seconds": 61.0, "reports": []}]}


def compared() -> dict[str, Any]:
    rows = [{"name": "window", "meaning": "strict", "a": "+0.0712", "b": "+0.0211"}, {"name": "exposure", "meaning": "", "a": "22.7 s", "b": "31.0 s"}]  # fmt: skip
    return {"rows": rows, "keys": [{"key": "turntable.angles", "a": "360", "b": "60"}]}
