"""What the page asks for: the workspace, texts, forms, presets, parts, and the stream of events."""

from __future__ import annotations

import http.client
import json
import time
from collections.abc import AsyncIterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from studio_client import BOAT, Client

from vamgpu.jobs.keys import keys_of
from vamgpu.jobs.progress import recorded
from vamgpu.jobs.read import Job
from vamgpu.studio import prints
from vamgpu.studio.events import KEPT, Events
from vamgpu.studio.forms import form
from vamgpu.studio.parts import Part, placed
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
    kinds = {
        key["name"]: key["type"] for table in ("target", "beam", "frames", "solve") for key in tables[table]["keys"]
    }
    known = {"mesh": "file", "pixels": "list", "footprint": "choice", "bits": "choice", "flip_r": "bool",
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
        client("POST", "/tasks", {"kind": "rehearse", "rig": "emulated", "result": "b.vam"}, 201)
    with Studio(tmp_path) as studio:
        studio.engine.look = lambda: None  # type: ignore[method-assign]
        tasks, started = studio.engine.tasks, list[str]()
        tasks._start = lambda task: started.append(task.request["kind"])  # type: ignore[method-assign]
        tasks.poll()
        assert tasks.one(first["id"]).state == "cancelled" and started == ["rehearse"]
    assert (tmp_path / ".studio").stat().st_mode & 0o077 == 0


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
