"""The routes of Studio: its page, its API under ``/api/v1``, and the print page."""

from __future__ import annotations

import mimetypes
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import AbstractContextManager, asynccontextmanager
from importlib.resources import files
from typing import Any

from anyio import CancelScope, to_thread
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, Request
from starlette.responses import FileResponse, Response, StreamingResponse
from starlette.routing import Mount, Route

from vamgpu.errors import VamError
from vamgpu.hosts.panel.routes import SANDBOX
from vamgpu.jobs.edit import edited
from vamgpu.jobs.keys import schema_of
from vamgpu.storage.atomic import replacing
from vamgpu.studio import requests as ask
from vamgpu.studio.answers import answer, explained, pieces, refused
from vamgpu.studio.forms import form
from vamgpu.studio.parts import MOST_BYTES, Mesh
from vamgpu.studio.server import Engine
from vamgpu.studio.volumes import Arrays
from vamgpu.studio.workspace import JOB, RESULT, Refused
from vamgpu.targets.mesh import FORMATS

CSP = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; worker-src 'self'; "
    "font-src 'self'; frame-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
STREAMS = 50  # pages that can listen at a time


def app(engine: Engine) -> Starlette:
    api = _Api(engine)
    inside = [*_files(api), *_jobs(api), *_tasks(api), *_results(api), *_prints(api)]
    routes = [Route("/", api.page), Route("/static/{path:path}", api.static), Mount("/print", engine.prints),
              Mount("/api/v1", routes=inside)]  # fmt: skip
    made = Starlette(routes=routes, exception_handlers={HTTPException: _unrouted})
    made.state.limiter = None  # made by the first request, in its loop
    return made


async def _unrouted(_: Request, error: Any) -> Response:
    return refused(error.status_code, f"{error.detail}; see the documents of the API")


def _post(path: str, handler: Callable[..., Any], body: Any = None, status: int = 200) -> Route:
    return Route(path, answer(handler, body, status=status), methods=["POST"])


def _get(path: str, handler: Callable[..., Any], query: Any = ask.Nothing) -> Route:
    return Route(path, answer(handler, query=query), methods=["GET"])


def _delete(path: str, handler: Callable[..., Any]) -> Route:
    return Route(path, answer(handler), methods=["DELETE"])


def _files(api: _Api) -> list[Route]:
    engine = api.engine
    return [
        _get("/workspace", engine.listing), Route("/events", api.events), Route("/parts", api.upload, methods=["POST"]),
        _get("/parts/{name}", api.part), _get("/parts/{name}/mesh", api.part_mesh, ask.Triangles),
        *(_delete(f"/{kind}/{{name}}", api.discard(*endings)) for kind, endings in
          (("parts", FORMATS), ("jobs", (JOB,)), ("results", (RESULT,)))),
        _get("/exports/{name}", api.export), _get("/devices", engine.devices),
    ]  # fmt: skip


def _jobs(api: _Api) -> list[Route]:
    texts, presets = api.engine.texts, api.engine.presets
    return [
        _post("/jobs/check", lambda body: texts.checked(body.text), ask.Check),
        _post("/jobs/edit", lambda body: texts.checked(edited(body.text, body.set, body.remove)), ask.Edit),
        _post("/jobs", api.new_job, ask.NewJob, 201),
        _get("/jobs/{name}", lambda name: texts.read(name)),
        Route("/jobs/{name}", answer(lambda name, body: texts.save(name, body.text, body.etag), ask.Save),
              methods=["PUT"]),
        _post("/jobs/{name}/copy", api.copy, ask.Copy, 201),
        _get("/jobs/{name}/scene", lambda name: texts.scene(name)), _get("/jobs/{name}/mesh", api.mesh, ask.Triangles),
        _get("/schema", form, ask.Kind), _get("/schema.json", lambda kind: schema_of(kind), ask.Kind),
        _get("/presets", presets.all),
        _post("/presets", lambda body: presets.add(body.family, body.name, body.source, body.set), ask.Preset, 201),
        _delete("/presets/{family}/{name}", presets.remove),
    ]  # fmt: skip


def _tasks(api: _Api) -> list[Route]:
    tasks = api.engine.tasks
    return [
        _get("/tasks", lambda: {"tasks": tasks.listed()}),
        _post("/tasks", api.add, ask.Task, 201),
        _get("/tasks/{name}", lambda name: tasks.described(tasks.one(name)) | {"history": tasks.history(name)}),
        _delete("/tasks/{name}", tasks.remove), _get("/tasks/{name}/slice", api.run_slice),
        _get("/tasks/{name}/log", lambda name: Response(tasks.log(name), media_type="text/plain; charset=utf-8")),
        _post("/tasks/{name}/cancel", lambda name: tasks.described(tasks.cancel(name))),
        _post("/tasks/{name}/resume", lambda name: tasks.described(tasks.resume(name)), status=201),
    ]  # fmt: skip


def _results(api: _Api) -> list[Route]:
    results, stacks, head = api.engine.results, api.engine.stacks, "/results/{name}"
    png = "image/png"
    return [
        _get(head, results.described, ask.Looked), _get(f"{head}/slice", results.slice, ask.Slice),
        _get(f"{head}/volume", results.volume, ask.Volume), _get(f"{head}/histogram", results.histogram, ask.Bins),
        _get(f"{head}/exposure", results.exposure, ask.Exposure), _get(f"{head}/surface", results.surface, ask.Surface),
        _get(f"{head}/frame", lambda name, **given: Response(results.frame(name, **given), media_type=png), ask.Frame),
        _get(f"{head}/sinogram", lambda name, row: Response(results.sinogram(name, row), media_type=png), ask.Sinogram),
        _get(f"{head}/report", lambda name: _page(results.report(name))),
        _get("/stacks/{name}", stacks.described),
        _get("/stacks/{name}/slice", lambda **given: Response(stacks.slice(**given), media_type=png), ask.StackSlice),
        _get("/stacks/{name}/report", lambda name, of: _page(stacks.report(name, of)), ask.StackReport),
        _get("/compare", lambda a, b: results.compare(a, b), ask.Compare),
    ]  # fmt: skip


def _prints(api: _Api) -> list[Route]:
    prints = api.engine.prints
    return [
        _get("/rigs/{name}", prints.rig, ask.Speed), _get("/runs", lambda: {"runs": prints.runs()}),
        _get("/runs/{run}/{name}", lambda run, name: _page(prints.report(run, name))), _get("/print", prints.now),
        _post("/print/attach", lambda body: prints.attach(body.run), ask.Attach),
    ]  # fmt: skip


def _page(content: bytes) -> Response:
    """A report, which runs its own script without access to this page, and may stand in a frame of it."""
    policy = SANDBOX.replace("frame-ancestors 'none'", "frame-ancestors 'self'")
    headers = {"content-security-policy": policy, "x-frame-options": "SAMEORIGIN"}
    return Response(content, media_type="text/html", headers=headers)


class _Api:
    """Answers that are more than one call."""

    def __init__(self, engine: Engine) -> None:
        self.engine, self._streams = engine, 0
        self._static = {"/".join(place): data for place, data in _walked(files("vamgpu.studio").joinpath("static"))}

    async def page(self, _: Request) -> Response:
        """The page."""
        return self._file("index.html")

    async def static(self, request: Request) -> Response:
        """A file of the page; all are known at the start, and no path leads elsewhere."""
        return self._file(request.path_params["path"])

    def _file(self, name: str) -> Response:
        if name not in self._static:
            return refused(404, "there is no such file")
        kind = mimetypes.guess_type(name)[0] or "application/octet-stream"
        return Response(self._static[name].read_bytes(), media_type=kind, headers={"content-security-policy": CSP})

    async def events(self, request: Request) -> Response:
        """The stream of events."""
        if self._streams >= STREAMS:
            return refused(503, f"{STREAMS} pages listen already; close some")

        async def told() -> AsyncIterator[str]:
            self._streams += 1  # not before: a page that has left already never comes here
            try:
                async for text in self.engine.events.stream(request.headers.get("last-event-id"), lambda: False):
                    yield text
            finally:
                self._streams -= 1

        return StreamingResponse(told(), media_type="text/event-stream")

    async def upload(self, request: Request) -> Response:
        """A part, written to the disk as it comes."""
        try:
            asked = ask.Upload.model_validate(dict(request.query_params))
            place = self.engine.workspace.place(asked.name, *FORMATS)
            if place.is_symlink() or (place.exists() and not asked.overwrite):
                raise Refused(409, f"{asked.name} exists; allow to overwrite it, or choose another name")
            async with _threaded(replacing(place, overwrite=asked.overwrite)) as draft:
                async with _threaded(draft.open("wb")) as file:
                    async for piece in pieces(request, MOST_BYTES):
                        await to_thread.run_sync(file.write, piece)
                if not draft.stat().st_size:
                    raise Refused(400, f"{asked.name} is empty; expected a mesh")
                await to_thread.run_sync(self.engine.texts.part, draft)  # one that cannot be read is not kept
            plain = Request({**request.scope, "path_params": {"name": asked.name}, "query_string": b""})
            return await answer(self.part, status=201)(plain)
        except ClientDisconnect:
            return Response(status_code=400)
        except (VamError, ValueError, MemoryError, OSError) as error:
            return explained(error)

    def part(self, name: str) -> dict[str, Any]:
        place = self.engine.workspace.existing(name, *FORMATS)
        found = place.stat()
        return {"id": name, "bytes": found.st_size, "modified": found.st_mtime,
                **self.engine.texts.part(place).described()}  # fmt: skip

    def part_mesh(self, name: str, most: int) -> Arrays:
        part = self.engine.texts.part(self.engine.workspace.existing(name, *FORMATS), most)
        return _mesh(part.mesh, part.mesh.positions, part.triangles)

    def mesh(self, name: str, most: int) -> Arrays:
        """Triangles of a job's part where the job places it."""
        found = self.engine.texts.mesh(name, most)
        return _mesh(found.mesh, found.positions, found.triangles, found.bodies)

    def new_job(self, body: ask.NewJob) -> dict[str, Any]:
        """A new job file from presets."""
        chosen = (("vials", body.vial), ("projectors", body.projector), ("resins", body.resin))
        presets = [one for family, name in chosen for one in self.engine.presets.named(family, name)]
        return self.engine.texts.new(body.name, body.part, body.height, presets)

    def copy(self, name: str, body: ask.Copy) -> dict[str, Any]:
        text = self.engine.texts.read(name)["text"]
        return self.engine.texts.save(body.name + ("" if body.name.endswith(JOB) else JOB), text, None)

    def discard(self, *endings: str) -> Callable[[str], None]:
        """A function that moves a file or folder to the trash, unless a task uses it."""

        def discarded(name: str) -> None:
            if name in self.engine.tasks.busy():
                raise Refused(409, f"a task uses {name}; cancel it, or wait for its end")
            self.engine.workspace.discard(name, *endings)

        return discarded

    def add(self, body: ask.Task) -> dict[str, Any]:
        return self.engine.tasks.described(self.engine.tasks.add(body.root.model_dump()))

    def run_slice(self, name: str) -> Arrays:
        """The newest slice of a run; the part is where the target is 255."""
        dose, target = self.engine.tasks.slice(name).astype("float32").transpose(0, 2, 1)[:, ::-1]
        return Arrays({"dose": dose, "target": (255 * target.clip(0.0, 1.0)).round().astype("uint8")}, {})

    def export(self, name: str) -> Response:
        """A file that an export made."""
        path = self.engine.workspace.existing(name, ".tiff", ".npz", ".mp4")
        return FileResponse(path, filename=name, media_type="application/octet-stream")


def _mesh(mesh: Mesh, positions: Any, triangles: int, bodies: Sequence[dict[str, Any]] = ()) -> Arrays:
    arrays = {"positions": positions.astype("float32"), "indices": mesh.indices, "owner": mesh.owner}
    return Arrays(arrays, {"triangles": triangles, "shown": len(mesh.indices), "cell": mesh.cell, "bodies": bodies})


@asynccontextmanager
async def _threaded(manager: AbstractContextManager[Any]) -> AsyncIterator[Any]:
    """A context whose begin and end wait for the disk, in threads."""
    value = await to_thread.run_sync(manager.__enter__)
    try:
        yield value
    except BaseException as error:
        with CancelScope(shield=True):
            await to_thread.run_sync(manager.__exit__, type(error), error, error.__traceback__)
        raise
    await to_thread.run_sync(manager.__exit__, None, None, None)


def _walked(folder: Any, above: tuple[str, ...] = ()) -> Any:
    """Files in a folder of the package, with their paths in it."""
    for each in folder.iterdir() if folder.is_dir() else ():
        if each.is_dir():
            yield from _walked(each, (*above, each.name))
        elif not each.name.startswith("."):
            yield (*above, each.name), each
