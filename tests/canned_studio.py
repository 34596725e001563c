"""A server that answers as the API of Studio does, from examples, without solving."""

from __future__ import annotations

import json
import queue
import re
import threading
import time
import tomllib
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, unquote, urlsplit

import canned_answers as canned
import numpy as np
from canned_answers import PITCH, png, surface, task, volumes
from scipy.ndimage import gaussian_filter

STATIC = Path(__file__).resolve().parent.parent / "vamgpu" / "studio" / "static"
TYPES = {
    ".html": "text/html",
    ".js": "text/javascript",
    ".css": "text/css",
    ".woff2": "font/woff2",
    ".svg": "image/svg+xml",
    ".txt": "text/plain",
}
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; font-src 'self'; "
    "worker-src 'self'; frame-src 'self'; base-uri 'none'; form-action 'none'"
)


class Studio:
    """The server; a context manager. ``answers`` replaces what a GET of a path yields; ``posts`` has what was sent."""

    def __init__(self, **changed: Any) -> None:
        self.text, self.version = canned.TEXT, 1
        self.tasks: list[dict[str, Any]] = changed.pop("tasks", [])
        self.result: dict[str, Any] | None = changed.pop("result", canned.result())
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
        now, empty = 1.79e9 + self.version, {"parts": [], "jobs": [], "results": []}
        state = "new" if self.result is None else self.result["state"]
        made = None if self.result is None else "boat.vam"
        error = self.check(self.text)["errors"]
        listed = {
            "parts": [{"id": "benchy.stl", "bytes": 11285384, "modified": now}],
            "jobs": [
                {
                    "id": "boat.toml",
                    "modified": now,
                    "kind": "vial",
                    "part": "benchy.stl",
                    "result": made,
                    "verdict": None if self.result is None else self.result["verdict"],
                    "state": "invalid" if error else state,
                    "error": "",
                }
            ],
            "results": []
            if self.result is None
            else [
                {
                    "id": name,
                    "kind": "vial",
                    "modified": now,
                    "job": job,
                    "bytes": 81233,
                    "state": self.result["state"],
                    "verdict": self.result["verdict"],
                }
                for name, job in (("boat.vam", "boat.toml"), ("boat-60.vam", None))
            ],
        }
        return {
            "name": "vamgpu-studio",
            "revision": 17,
            "opened": None,
            **(empty if self.empty else listed),
            "rigs": [{"id": "emulated"}, {"id": "lab.toml"}],
            "trash": 0,
        }


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
        part = {
            "id": "benchy.stl",
            "bytes": 11285384,
            "modified": 0.0,
            "triangles": 225706,
            "unit": "mm",
            "doubts": [],
            "low": [-30.0, -15.5, 0.0],
            "high": [30.0, 15.5, 48.0],
            "extents": [60.0, 31.0, 48.0],
        }
        return {
            "workspace": owner.workspace,
            "jobs/boat.toml": owner.job,
            "parts/benchy.stl": lambda: part,
            "tasks": lambda: {"tasks": owner.tasks},
            "schema": canned.schema,
            "jobs/boat.toml/scene": canned.scene,
            "presets": canned.presets,
            "print": lambda: {"run": None, "state": None, "page": "/print/"},
            "devices": lambda: {"devices": [{"name": "pocl", "description": "PoCL, two cores"}], "ready": True},
            "runs": canned.runs,
            "rigs/emulated": canned.rig,
            "rigs/lab.toml": canned.rig,
            "compare": canned.compared,
        }.get(name, lambda: None)()

    def pieces(self, name: str) -> None:
        part, dose = volumes()
        if name.endswith("slice"):
            middle = {"dose": dose[:, 48].T[::-1], "target": (part[:, 48].T[::-1] > 0.5).astype(np.uint8)}
            return self.arrays(middle)
        made = surface("target")
        points = made["positions"] * np.float32(1.0 if name.startswith("jobs") else 5.0)
        if not name.startswith("jobs"):
            points = points + np.array([0, 0, 24], np.float32)
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
            found = {"missing": missing, "excess": excess, "iou": 0.98, "seconds": 23.0}
            return self.json({"dose": float(query["dose"]), **found})
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
