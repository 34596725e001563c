"""What the page asks for: the workspace, texts, forms, presets, parts, and the stream of events."""

from __future__ import annotations

import http.client
import json
import os
import threading
import time
import tomllib
from collections.abc import AsyncIterator, Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
from studio_client import BOAT, Client

from vamgpu.errors import BadInput
from vamgpu.hosts.records.state import PrintState
from vamgpu.jobs import progress
from vamgpu.jobs.build import scene_of
from vamgpu.jobs.curethrough import CurethroughJob
from vamgpu.jobs.keys import keys_of
from vamgpu.jobs.progress import recorded
from vamgpu.jobs.read import Job
from vamgpu.jobs.web import WebJob
from vamgpu.methods.plan import Step
from vamgpu.storage.atomic import replacing
from vamgpu.storage.folder import Entry, write_folder
from vamgpu.studio import prints, routes
from vamgpu.studio.events import KEPT, Events
from vamgpu.studio.forms import form
from vamgpu.studio.parts import Part, is_closed, placed
from vamgpu.studio.server import Studio
from vamgpu.studio.workspace import Workspace
from vamgpu.targets import shapes
from vamgpu.targets.mesh import load_mesh
from vamgpu.targets.stl import RECORD


def test_the_workspace_lists_what_the_command_line_left(client: Client, tmp_path: Path) -> None:
    lab = tmp_path / "lab"
    (lab / "rig.toml").write_text((Path(__file__).parents[2] / "docs" / "rigs" / "epfl.toml").read_text())
    (lab / "bad.toml").write_text("[target]\nshape = 1\n")
    (lab / ".x.toml").write_text("")
    shapes.build("boat").save(lab / "part.stl")
    found = client("GET", "/workspace")
    assert [(job["id"], job["state"]) for job in found["jobs"]] == [("bad.toml", "invalid"), ("boat.toml", "new")]
    assert "line 2: target" in found["jobs"][0]["error"] and found["opened"] == "boat.toml"
    assert [part["id"] for part in found["parts"]] == ["part.stl"]
    assert [rig["id"] for rig in found["rigs"]] == ["emulated", "rig.toml"]
    with recorded(lab / "boat.vam", "solve"):  # as a command line in a terminal does
        assert client("GET", "/workspace")["jobs"][1]["state"] == "running"
    client("DELETE", "/jobs/bad.toml")
    after = client("GET", "/workspace")
    assert after["trash"] == 1 and len(after["jobs"]) == 1 and len(list((lab / "trash").iterdir())) == 1


def test_pages_that_ask_at_once_lose_no_step(client: Client, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tasks, whole, both = client.studio.engine.tasks, progress.open_file, threading.Barrier(2)
    monkeypatch.setattr(tasks, "_start", lambda task: None)
    task = tasks.one(client("POST", "/tasks", {"kind": "solve", "job": "boat.toml"}, 201)["id"])
    task.pid = os.getpid()
    monkeypatch.setattr(progress, "PERIOD", 0.0)

    @contextmanager
    def together(path: Path) -> Iterator[SimpleNamespace]:
        def read(most: int) -> bytes:
            data = file.read(most)
            with suppress(threading.BrokenBarrierError):
                both.wait(0.2)
            return data

        with whole(path) as file:
            yield SimpleNamespace(fileno=file.fileno, seek=file.seek, readline=file.readline, read=read)

    monkeypatch.setattr(progress, "open_file", together)
    with recorded(tmp_path / "lab" / "boat.vam", "solve") as events:
        for number in range(1, 42):
            events.step(Step(number, 1.0, 0.1, 0.25))
            events.share("light", "optimizing", 0.01)
            if number == 5:
                with ThreadPoolExecutor(2) as pages:
                    list(pages.map(tasks.history, [task.id] * 2))
    assert tasks.history(task.id)["iteration"] == list(range(1, 42))


@pytest.mark.parametrize(("change", "state"), [
    (lambda text: text, "solved"), (lambda text: f"# a remark\n{text}\n", "solved"),
    (lambda text: text.replace("[solve]", '[solve]\ndevice = "pocl"'), "solved"),
    (lambda text: text.replace('"1.0 mm"', '"1.1 mm"'), "changed"),
    (lambda text: text.replace("angles = 40", ""), "changed"),
])  # fmt: skip
def test_a_job_has_changed_if_its_keys_differ(
    client: Client, tmp_path: Path, change: Callable[[str], str], state: str
) -> None:
    lab = tmp_path / "lab"
    inputs = {"job": tomllib.loads(BOAT.replace("[solve]", '[solve]\ndevice = "numpy"'))}
    frames = Entry(np.zeros((2, 3, 4), np.uint8), ("angle", "row", "column"))
    write_folder(lab / "boat.vam", {"frames": frames}, inputs=inputs, details={}, device="numpy")
    (lab / "boat.toml").write_text(change(BOAT))
    os.utime(lab / "boat.toml", (2e9, 2e9))  # times of files, which a copy changes, do not count
    (job,) = client("GET", "/workspace")["jobs"]
    assert (job["state"], job["result"]) == (state, "boat.vam")


def test_texts_and_fields_are_two_views_of_a_job(client: Client) -> None:
    job = client("GET", "/jobs/boat.toml")
    assert job["text"] == BOAT and job["errors"] == [] and job["fields"]["vial"]["radius"] == "12.4 mm"
    edited = client("POST", "/jobs/edit", {"text": BOAT, "set": {"vial.radius": "12.4 s"}, "remove": ["target.pitch"]})
    assert edited["text"] == BOAT.replace('"12.4 mm"', '"12.4 s"').replace('pitch = "250 um"\n\n[beam]', "\n[beam]")
    (wrong,) = edited["errors"]
    assert wrong["field"] == "vial.radius" and wrong["line"] == edited["text"][: edited["text"].index("12.4 s")].count(
        "\n"
    ) + 1 and "expected a length" in wrong["message"]  # fmt: skip
    saved = client("PUT", "/jobs/boat.toml", {"text": edited["text"], "etag": job["etag"]})
    assert saved["errors"] == [wrong] and client("GET", "/jobs/boat.toml")["text"] == edited["text"]
    client("PUT", "/jobs/boat.toml", {"text": BOAT, "etag": job["etag"]}, 409)
    copy = client("POST", "/jobs/boat.toml/copy", {"name": "second"}, 201)
    assert copy["id"] == "second.toml" and copy["text"] == edited["text"]
    assert client("POST", "/jobs/check", {"text": "\n[a b]"})["errors"][0]["line"] == 2


def test_a_new_job_takes_its_values_from_presets(client: Client) -> None:
    presets = client("GET", "/presets")
    assert all(one["source"] and not one["own"] for family in presets.values() for one in family)
    own = client("POST", "/presets", {"family": "vials", "name": "Ours, 20 mm", "set": {"vial.radius": "10 mm"}}, 201)
    assert own["own"] and own in client("GET", "/presets")["vials"]
    for vial in (*presets["vials"], own):
        chosen = {"vial": vial["id"], "projector": presets["projectors"][0]["id"], "resin": presets["resins"][0]["id"]}
        made = client("POST", "/jobs", {"name": f"job-{vial['id']}", **chosen}, 201)
        assert made["errors"] == [] and made["fields"]["vial"]["radius"] == vial["set"]["vial.radius"]
    client("DELETE", f"/presets/vials/{own['id']}")
    assert client.raw("DELETE", f"/presets/vials/{presets['vials'][0]['id']}")[0] == 404
    assert client("GET", "/presets") == presets


def test_the_form_has_every_key_with_unit_bounds_and_meaning(client: Client) -> None:
    found = client("GET", "/schema")
    tables = {table["name"]: table for table in found["tables"]}
    assert list(tables) == list(Job.model.model_fields) and found == json.loads(json.dumps(form()))
    for name in ("target", "beam", "vial", "solve", "print", "tolerances"):
        assert [(key["name"], key["doc"]) for key in tables[name]["keys"]] == [(k.name, k.doc) for k in keys_of(name)]
    radius = tables["vial"]["keys"][0]
    assert (radius["type"], radius["unit"], radius["above"], radius["required"]) == ("quantity", "mm", 0.0, True)
    assert tables["beam"]["keys"][0]["unit"] == "um"
    for kind, names in (("web", WebJob.model.model_fields), ("slices", CurethroughJob.model.model_fields)):
        assert [table["name"] for table in client("GET", f"/schema?kind={kind}")["tables"]] == list(names)
    kinds = {
        key["name"]: key["type"] for table in ("target", "beam", "frames", "solve") for key in tables[table]["keys"]
    }
    known = {"mesh": "file", "pixels": "list", "bits": "choice", "flip_r": "bool",
             "fill": "number", "iterations": "count", "method": "text", "height": "quantity"}  # fmt: skip
    assert {name: kinds[name] for name in known} == known
    fields = {(table, key["name"]): key["type"] for table in tables for key in tables[table]["keys"]}
    assert fields["turntable", "angles"] == fields["beam", "spread"] == "any"  # a number or a file
    assert fields["scattering", "anisotropy"] == "number"  # or a word
    assert fields["scattering", "photons"] == "count" and fields["scattering", "tolerance"] == "number"
    assert "vessel.fan" in tables["vessel"]["kinds"] and found["components"]["vessel.fan"]["keys"]
    assert client("GET", "/schema.json")["type"] == "object"


def test_the_scene_says_what_does_not_fit(client: Client) -> None:
    scene = client("GET", "/jobs/boat.toml/scene")
    assert scene["problems"] == [] and scene["vessel"]["inner"] == pytest.approx(11.4)
    assert scene["vessel"]["lit"] == pytest.approx(Job.parse(BOAT).file.vial.lit_radius)  # type: ignore[union-attr]
    assert scene["beam"]["reach"] < 0.5 * scene["beam"]["width"]  # refraction narrows the columns
    assert scene["part"]["extents"][2] == pytest.approx(6.0) and scene["beam"]["pitch"] == 0.25
    large = BOAT.replace('"6 mm"', '"60 mm"').replace(
        'pitch = "250 um"\n\n[turn', 'pitch = "250 um"\npixels = [9, 9]\n[turn'
    )
    etag = client("GET", "/jobs/boat.toml")["etag"]
    client("PUT", "/jobs/boat.toml", {"text": large, "etag": etag})
    (problem,) = client("GET", "/jobs/boat.toml/scene")["problems"]
    assert problem["field"] == "target" and "vial" in problem["message"]
    few = large.replace('"60 mm"', '"6 mm"')
    client("PUT", "/jobs/boat.toml", {"text": few, "etag": client("GET", "/jobs/boat.toml")["etag"]})
    assert [one["field"] for one in client("GET", "/jobs/boat.toml/scene")["problems"]] == ["beam.pixels"] * 2


def test_a_part_is_drawn_where_the_job_places_it(client: Client, tmp_path: Path) -> None:
    solid = shapes.build("boat").scaled(3.0)
    solid.save(tmp_path / "lab" / "part.stl")
    turned = [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
    text = BOAT.replace('shape = "boat"', f'mesh = "part.stl"\norientation = {turned}')
    client("PUT", "/jobs/part.toml", {"text": text})
    arrays, _ = client.arrays("/jobs/part.toml/mesh")
    asked = load_mesh(tmp_path / "lab" / "part.stl", rotation=turned, height=6.0)
    low, high = asked.bounds
    np.testing.assert_allclose(
        [arrays["positions"].min(axis=0), arrays["positions"].max(axis=0)], [low, high], atol=2e-3
    )
    plain, meta = client.arrays("/parts/part.stl/mesh?most=1000")
    assert meta["shown"] == len(plain["indices"]) <= 1000 < meta["triangles"] and plain["indices"].max() < len(
        plain["positions"]
    )
    near = np.abs(np.ptp(plain["positions"], axis=0) - np.ptp(solid.bounds, axis=0))
    assert (near <= 2.0 * meta["cell"]).all()


def test_parts_of_a_doubtful_unit_are_named(tmp_path: Path) -> None:
    for scale, word in ((1e-3, "inches or m"), (1.0, ""), (1e3, "µm")):
        shapes.build("boat").scaled(scale * 2.0).save(tmp_path / "part.stl")
        doubts = " ".join(Part.load(tmp_path / "part.stl").described()["doubts"])
        assert (word in doubts) and bool(word) == bool(doubts)


BODIES = """
[target]
factor = 0.5
orientation = [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]

[[body]]
mesh = "two.3mf"
part = 2

[[body]]
mesh = "two.3mf"
part = 1
role = "keep out"
dose = 0.7

[[body]]
shape = "nut"
role = "don't care"
"""


def two(place: Path, name: str = "pin") -> None:
    """A 3MF file of a block and a pin beside it."""
    block, pin = trimesh.creation.box((6, 6, 8)), trimesh.creation.cylinder(1.0, 10.0, sections=32)
    pin.apply_translation((5.0, 2.0, 3.0))
    scene = trimesh.Scene({"block": block, name: pin})
    scene.units = "millimeter"
    scene.export(place)


def test_bodies_are_drawn_where_the_scene_places_them(client: Client, tmp_path: Path) -> None:
    lab = tmp_path / "lab"
    two(lab / "two.3mf")
    found = client("GET", "/parts/two.3mf")
    assert ([body["name"] for body in found["bodies"]], found["doubts"]) == (["block", "pin"], [])
    beam = BOAT[BOAT.index("[beam]") :]
    for more in ("", "origin = [1.0, 2.0, 3.0]\n"):
        text = BODIES.replace("[[body]]", f"{more}\n[[body]]", 1) + beam
        etag = client("GET", "/jobs/two.toml")["etag"] if (lab / "two.toml").exists() else None
        assert client("PUT", "/jobs/two.toml", {"text": text, "etag": etag})["errors"] == []
        arrays, meta = client.arrays("/jobs/two.toml/mesh")
        made = scene_of(Job.read(lab / "two.toml").file, lab)
        assert made is not None and meta["shown"] == len(arrays["indices"]) == len(arrays["owner"])
        for number, body in enumerate(made.bodies):
            solid = body.solid(made.place)
            points = arrays["positions"][np.unique(arrays["indices"][arrays["owner"] == number])]
            assert solid is not None
            np.testing.assert_allclose([points.min(axis=0), points.max(axis=0)], solid.bounds, atol=1e-4)
        scene = client("GET", "/jobs/two.toml/scene")
        assert scene["problems"] == [] and scene["vessel"]["inner"] and scene["beam"]["width"] > 0.0
        radius, low, high = made.printed[0].reach(made.place) or (0.0, 0.0, 0.0)
        assert scene["part"]["radius"] == pytest.approx(radius, rel=1e-4)
        assert [scene["part"]["low"][2], scene["part"]["high"][2]] == pytest.approx([low, high], abs=1e-4)


def test_names_that_are_roles_are_shown_and_drawn_if_the_job_asks(client: Client, tmp_path: Path) -> None:
    lab = tmp_path / "lab"
    two(lab / "two.3mf", "insert pin")
    assert client("GET", "/parts/two.3mf")["bodies"] == [
        {"name": "block", "role": None}, {"name": "insert pin", "role": "insert"}]  # fmt: skip
    text = (
        '[target]\n[[body]]\nshape = "nut"\n[[body]]\nmesh = "two.3mf"\nroles = "names"\n'
        + BOAT[BOAT.index("[beam]") :]
    )
    assert client("PUT", "/jobs/two.toml", {"text": text})["errors"] == []
    arrays, meta = client.arrays("/jobs/two.toml/mesh")
    assert [(body["entry"], body["name"], body["role"]) for body in meta["bodies"]] == [
        (0, "nut", "print"), (1, "block", "print"), (1, "insert pin", "insert")]  # fmt: skip
    made = scene_of(Job.read(lab / "two.toml").file, lab)
    assert made is not None and [body.role for body in made.bodies] == ["print", "print", "insert"]
    for number, body in enumerate(made.bodies):
        solid = body.solid(made.place)
        points = arrays["positions"][np.unique(arrays["indices"][arrays["owner"] == number])]
        assert solid is not None
        np.testing.assert_allclose([points.min(axis=0), points.max(axis=0)], solid.bounds, atol=1e-4)


def test_a_body_that_a_file_lacks_is_named(client: Client, tmp_path: Path) -> None:
    two(tmp_path / "lab" / "two.3mf")
    text = BODIES.replace("part = 2", "part = 3") + BOAT[BOAT.index("[beam]") :]
    client("PUT", "/jobs/two.toml", {"text": text})
    status, said, _ = client.raw("GET", "/jobs/two.toml/mesh")
    assert status == 422 and b"expected part 1 to 2, not 3" in said
    (wrong,) = client("POST", "/jobs/check", {"text": text.replace('"two.3mf"', '"part.stl"', 1)})["errors"][:1]
    assert wrong["field"].startswith("body.0")


@pytest.mark.parametrize("change", ["none", "missing", "turned", "moved"])
def test_a_surface_with_gaps_is_told_at_once(change: str) -> None:
    solid = shapes.build("gear_base")
    corners, faces = solid.vertices.T.astype(np.float32), solid.faces.copy()
    soup = np.ascontiguousarray(corners[:, faces.ravel()])
    if change == "moved":
        soup[0, 7] = np.nextafter(soup[0, 7], np.float32(9.0))
    order = np.arange(soup.shape[1]).reshape(-1, 3)
    order = (
        order[1:] if change == "missing" else np.vstack([order[:1, ::-1], order[1:]]) if change == "turned" else order
    )
    assert is_closed(soup, order) is (change == "none")


def test_a_part_with_a_gap_is_doubted_when_it_is_uploaded(client: Client, tmp_path: Path) -> None:
    data = shapes.build("nut").save(tmp_path / "nut.stl").read_bytes()
    assert client("POST", "/parts?name=nut.stl", data, 201)["doubts"] == []
    count = int.from_bytes(data[80:84], "little") - 1
    cut = data[:80] + count.to_bytes(4, "little") + data[84:-50]
    (doubt,) = client("POST", "/parts?name=cut.stl", cut, 201)["doubts"]
    assert "the surface has gaps" in doubt


def test_an_upload_waits_for_the_disk_in_threads(
    client: Client, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    waited: dict[str, str] = {}

    @contextmanager
    def slow(path: Path, overwrite: bool) -> Iterator[Path]:
        waited["begin"] = threading.current_thread().name
        with replacing(path, overwrite=overwrite) as draft:
            yield draft
        waited["end"] = threading.current_thread().name

    monkeypatch.setattr(routes, "replacing", slow)
    client("POST", "/parts?name=nut.stl", shapes.build("nut").save(tmp_path / "nut.stl").read_bytes(), 201)
    assert set(waited) == {"begin", "end"} and all(name.startswith("AnyIO worker") for name in waited.values())


@pytest.mark.parametrize("ending", [".stl", ".ply", ".obj", ".3mf"])
def test_a_part_of_every_format_is_shown(ending: str, tmp_path: Path) -> None:
    trimesh.creation.box((2.0, 3.0, 4.0)).export(tmp_path / f"box{ending}")
    part = Part.load(tmp_path / f"box{ending}")
    assert (part.triangles, part.solids) == (12, 1)
    np.testing.assert_allclose(
        np.subtract(part.described()["high"], part.described()["low"]), (2.0, 3.0, 4.0), rtol=1e-5
    )


def test_a_coarse_mesh_keeps_the_extents_of_a_large_file(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    way = rng.normal(size=(60_000, 3))
    corners = 10.0 * way / np.linalg.norm(way, axis=1, keepdims=True)
    records = np.zeros(len(corners), RECORD)
    records["corners"] = corners[:, None] + rng.normal(0.0, 0.05, (len(corners), 3, 3))
    place = tmp_path / "ball.stl"
    place.write_bytes(b"\0" * 80 + len(records).to_bytes(4, "little") + records.tobytes())
    part = Part.load(place, 10_000)
    low, high = records["corners"].min(axis=(0, 1)), records["corners"].max(axis=(0, 1))
    np.testing.assert_allclose([part.described()["low"], part.described()["high"]], [low, high])
    assert 0 < len(part.mesh.indices) <= 10_000 and part.triangles == 60_000
    hull = placed(part.hull, part.hull, {"height": 5.0})[1]
    assert np.ptp(hull[:, 2]) == pytest.approx(5.0) and np.hypot(hull[:, 0], hull[:, 1]).max() == pytest.approx(
        2.5, rel=0.02
    )


def test_events_resume_after_the_last_one_that_a_page_knows() -> None:
    import asyncio

    events = Events()
    for number in range(5):
        events.publish("task", {"number": number})

    async def told(last: str | None, many: int) -> list[str]:
        return [text async for _, text in _some(events.stream(last, lambda: False), many)]

    def run(last: str | None, many: int) -> str:
        return "".join(asyncio.run(told(last, many)))

    first = run(None, 1)
    assert "event: reset" in first and "task" not in first
    boot = first.partition("id: ")[2].partition("-")[0]
    again = run(f"{boot}-3", 3)
    assert "reset" not in again and '{"number": 3}' in again and '{"number": 4}' in again and '"number": 2' not in again
    for last in ("other-3", f"{boot}-99", f"{boot}-x", "", f"{boot}--1"):
        assert "event: reset" in run(last, 1)
    for number in range(KEPT):
        events.publish("task", {"number": number})
    assert "event: reset" in run(f"{boot}-3", 1)


async def _some(stream: AsyncIterator[str], many: int) -> AsyncIterator[tuple[int, str]]:
    for number in range(many):
        yield number, await anext(stream)


def test_a_page_hears_of_changes_by_others(client: Client, tmp_path: Path) -> None:
    line = http.client.HTTPConnection("127.0.0.1", client.studio.port, timeout=60)
    line.request("GET", "/api/v1/events", headers={"Authorization": f"Bearer {client.studio.token}"})
    answer = line.getresponse()
    assert answer.status == 200 and (answer.getheader("content-type") or "").startswith("text/event-stream")
    (tmp_path / "lab" / "other.toml").write_text(BOAT)
    end, said = time.monotonic() + 60.0, b""
    while b"event: workspace" not in said and time.monotonic() < end:
        said += answer.readline()
    assert b"event: reset" in said and b"event: workspace" in said


def test_devices_are_listed_after_a_moment(client: Client) -> None:
    end = time.monotonic() + 60.0
    while not (found := client("GET", "/devices"))["ready"] and time.monotonic() < end:
        time.sleep(0.05)
    assert "numpy" in [each["name"] for each in found["devices"]]


def test_buttons_of_the_print_page_work_while_every_handler_is_busy(client: Client) -> None:
    engine, free, pressed = client.studio.engine, threading.Event(), threading.Event()
    engine.prints._board.button("pause", pressed.set)
    engine.prints._board.show(state=PrintState.PRINTING)
    busy = [threading.Thread(target=client.raw, args=("GET", "/runs")) for _ in range(60)]
    engine.prints.runs = lambda: free.wait(60.0) and []  # type: ignore[method-assign]
    for thread in busy:
        thread.start()
    line = http.client.HTTPConnection("127.0.0.1", client.studio.port, timeout=30)
    try:
        line.request("POST", "/print/press/pause", headers={"Authorization": f"Bearer {client.studio.token}"})
        assert line.getresponse().status == 200 and pressed.is_set()
    finally:
        free.set()
        for thread in busy:
            thread.join()


def test_the_queue_runs_one_task_at_a_time_on_a_device_and_survives(tmp_path: Path) -> None:
    for name in ("a", "b"):
        (tmp_path / f"{name}.toml").write_text(BOAT)
    with Studio(tmp_path) as studio:
        client, tasks = Client(studio), studio.engine.tasks
        started: list[str] = []
        tasks._start = lambda task: started.append(task.request["job"]) or setattr(task, "state", "running")  # type: ignore
        tasks._look = lambda task: None  # type: ignore[method-assign]
        studio.engine.look = lambda: None  # type: ignore[method-assign]
        first, second = (client("POST", "/tasks", {"kind": "solve", "job": f"{job}.toml"}, 201) for job in "ab")
        client(
            "POST", "/tasks", {"kind": "solve", "job": "a.toml", "device": "numpy"}, 409
        )  # it writes the same folder
        tasks.poll()
        assert started == ["a.toml"] and client("GET", "/workspace")["jobs"][1]["state"] == "queued"
        assert [task["id"] for task in client("GET", "/tasks")["tasks"]] == [second["id"], first["id"]]
        cancelled = client("POST", f"/tasks/{second['id']}/cancel")
        assert cancelled["state"] == "cancelled" and not cancelled["resumable"]
        client("DELETE", f"/tasks/{second['id']}")
        assert client.raw("DELETE", f"/tasks/{first['id']}")[0] == 409
    with Studio(tmp_path) as studio:
        (left,) = Client(studio)("GET", "/tasks")["tasks"]
        assert left["id"] == first["id"] and left["request"]["job"] == "a.toml"


def test_a_print_begins_only_when_it_is_started_and_only_one_on_a_rig(tmp_path: Path) -> None:
    for name in ("a.vam", "b.vam"):
        (tmp_path / name).mkdir()
    given = {"kind": "print", "rig": "emulated"}
    with Studio(tmp_path) as studio:
        studio.engine.look = lambda: None  # type: ignore[method-assign]
        client, tasks = Client(studio), studio.engine.tasks
        first = client("POST", "/tasks", given | {"result": "a.vam", "confirm": "a.vam"}, 201)
        client("POST", "/tasks", given | {"result": "b.vam", "confirm": "b.vam"}, 409)
        watched = {"kind": "rehearse", "rig": "emulated", "result": "b.vam", "live": True, "turns": 16}
        arguments = tasks.one(client("POST", "/tasks", watched, 201)["id"]).facts["arguments"]
        assert arguments == ["print", "b.vam", "--rig", "emulated", "--out", "b.dry-run", "--dry-run", "--live",
                             "--turns", "16"]  # fmt: skip
    with Studio(tmp_path) as studio:
        studio.engine.look = lambda: None  # type: ignore[method-assign]
        tasks, started = studio.engine.tasks, list[str]()
        tasks._start = lambda task: started.append(task.request["kind"])  # type: ignore[method-assign]
        tasks.poll()
        assert tasks.one(first["id"]).state == "cancelled" and started == ["rehearse"]
    assert (tmp_path / ".studio").stat().st_mode & 0o077 == 0
    with pytest.raises(BadInput, match="there is no .*mistyped"):
        Workspace(tmp_path / "mistyped")
    assert not (tmp_path / "mistyped").exists()


def test_a_page_that_shows_another_run_keeps_it_while_a_print_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    workspace = Workspace(tmp_path)
    for name in ("a.run", "b.run"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "run.json").write_text("{}")
    watch = SimpleNamespace(order=SimpleNamespace(planned=dict), viewed=lambda _: None, __exit__=lambda *_: None)
    monkeypatch.setattr(prints, "running", lambda place: place.name == "a.run")
    monkeypatch.setattr(prints, "attached", lambda place, board: watch)
    shown = prints.Prints(workspace)
    assert shown.follow("a.run") and shown.run == "a.run" and not shown.follow("a.run")
    shown.attach("b.run")
    assert not shown.follow("a.run") and shown.run == "b.run"
    workspace.close()
