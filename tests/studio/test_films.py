"""Webs and stacks of slices in Studio: what the command line left is listed, shown and judged."""

from __future__ import annotations

import io
import json
import os
from collections.abc import Iterator
from pathlib import Path

import axe
import needs
import numpy as np
import pytest
from PIL import Image
from studio_client import Client

from vamgpu.cli import main
from vamgpu.curethrough.images import encode
from vamgpu.curethrough.stack import open_stack
from vamgpu.hosts.panel import server as panels
from vamgpu.studio.server import Studio
from vamgpu.webs.proof import prove_web
from vamgpu.webs.store import WebFolder

WEB = """\
[film]
thickness = "3 mm"
resin_index = 1.49
bath_index = 1.33
absorption = "2.2 1/cm"

[roller]
radius = "7.5 mm"
step = "6 deg"

[lens]
bins = 3

[web]
length = "6 mm"

[target]
lattice = "SheetGyroid"
cell = "6 mm"

[beam]
pitch = "640 um"
height = "1.3 mm"

[solve]
iterations = 2
core = 1.0
device = "numpy"
"""
STACK = """\
[printer]
absorption_height = "0.47 mm"
critical_dose = "636 mJ/cm3"
slice_height = "50 um"
speed = "180 mm/h"
light = "10 mW/cm2"
dark = "0.01 mW/cm2"

[slices]
path = "slices"

[correct]
device = "numpy"
"""


def block() -> np.ndarray:
    """A block with a channel of ten slices [slice, y, x]."""
    slices = np.full((40, 8, 12), 255, np.uint8)
    slices[10:20, 2:6] = 0
    return slices


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("films")
    (place / "film.toml").write_text(WEB)
    (place / "block.toml").write_text(STACK)
    (place / "slices").mkdir()
    for number, slice_ in enumerate(block()):
        (place / "slices" / f"slice_{number:03d}.png").write_bytes(encode(slice_, ".png"))
    assert main(["solve", str(place / "film.toml")]) in (0, None)
    return place


@pytest.fixture(scope="module")
def finished(lab: Path) -> Path:
    """The same with reports: the web is proved, the slices are modeled and corrected."""
    assert main(["prove", str(lab / "film.vam"), "--device", "numpy"]) in (0, None)
    for verb in ("model", "correct"):
        assert main(["curethrough", verb, str(lab / "block.toml")]) in (0, None)
    return lab


@pytest.fixture
def client(lab: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Client]:
    monkeypatch.setattr(panels, "STARTING", 200.0)
    with Studio(lab) as studio:
        monkeypatch.setattr(studio.engine.tasks, "_start", lambda task: None)
        yield Client(studio)


def job(client: Client, name: str) -> dict[str, object]:
    return next(each for each in client("GET", "/workspace")["jobs"] if each["id"] == name)


def image(client: Client, path: str) -> np.ndarray:
    status, data, _ = client.raw("GET", path)
    assert status == 200, data
    return np.asarray(Image.open(io.BytesIO(data)))


def test_a_web_is_shown_with_its_window_and_focus_planes(client: Client, lab: Path) -> None:
    scene = client("GET", "/jobs/film.toml/scene")
    assert scene["problems"] == [] and scene["web"]["outer"] == 10.5 and len(scene["web"]["planes"]) == 3
    found, folder = client("GET", "/results/film.vam"), WebFolder.open(lab / "film.vam")
    layout, along = folder.details["layout"], folder.details["grid"]["pitch"][0]
    assert found["kind"] == "web" and found["frames"]["count"] == folder.frames and found["web"]["complete"]
    assert found["web"]["window"] == pytest.approx(layout["window"] * along)
    assert found["web"]["planes"] == pytest.approx(scene["web"]["planes"])
    assert [each["frames"][1] for each in found["web"]["segments"]] == [each.frames[1] for each in folder.segments]
    bins = np.array(folder.details["frames"]["focus"]["bin"])
    middle = max(range(folder.frames), key=lambda k: len(set(bins[folder.frame(k).any(axis=0)])))
    whole = image(client, f"/results/film.vam/frame?index={middle}")
    np.testing.assert_array_equal(whole, folder.frame(middle))
    for plane in range(3):
        part = image(client, f"/results/film.vam/frame?index={middle}&plane={plane}")
        np.testing.assert_array_equal(part, whole * (bins == plane))
    assert len(set(bins[whole.any(axis=0)])) > 1
    for wrong in (f"index={folder.frames}", "index=0&plane=3"):
        assert client.raw("GET", f"/results/film.vam/frame?{wrong}")[0] == 400


@pytest.mark.slow
def test_a_proved_web_tells_its_verdict_until_it_is_solved_anew(client: Client, finished: Path) -> None:
    lab, proof = finished, prove_web(finished / "film.vam", "numpy")
    found = client("GET", "/results/film.vam")
    assert (found["state"], found["verdict"]["sentence"]) == ("proved", proof.verdict[1])
    assert found["verdict"]["prints"] is proof.verdict[0] and job(client, "film.toml")["kind"] == "web"
    status, page, headers = client.raw("GET", "/results/film.vam/report")
    assert status == 200 and b"Web proof" in page and "frame-ancestors 'self'" in headers["content-security-policy"]
    (lab / "film.toml").write_text(f"# remarks do not matter\n{WEB}")
    assert job(client, "film.toml")["state"] == "proved"
    (lab / "film.toml").write_text(WEB.replace("6 deg", "7 deg"))
    assert job(client, "film.toml")["state"] == "changed"
    (lab / "film.toml").write_text(WEB)
    later = os.stat(lab / "film.html").st_mtime_ns + 1
    os.utime(lab / "film.vam" / "web.json", ns=(later, later))
    assert client("GET", "/results/film.vam")["state"] == "solved"
    os.utime(lab / "film.html", ns=(later, later))


def test_what_a_web_has_not_is_refused(lab: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for option in (["--save", "x.proof"], ["--off", "dose=-5 %"], ["--tolerances"]):
        assert main(["prove", str(lab / "film.vam"), *option]) == 1
        assert f"{option[0]} is for the job of a vial" in capsys.readouterr().err


def test_focus_planes_share_the_light_of_a_step(lab: Path) -> None:
    proof, folder = prove_web(lab / "film.vam", "numpy"), WebFolder.open(lab / "film.vam")
    other = {**folder.details, "frames": {**folder.details["frames"], "focus": None}}
    alone = prove_web(WebFolder(folder.path, other, folder.segments, True), "numpy")
    assert proof.light.way == pytest.approx(alone.light.way / 3)  # what the film moves while a frame is lit [columns]
    assert proof.iou != alone.iou


def test_slices_without_a_report_are_shown(client: Client, lab: Path) -> None:
    (lab / "new.toml").write_text(STACK.replace('"slices"', '"raw"'))
    (lab / "raw").mkdir()
    (lab / "raw" / "1.png").write_bytes(encode(block()[12], ".png"))
    found = client("GET", "/stacks/new.toml")
    assert found["before"] == {"name": "raw", "shape": [1, 8, 12]} and found["after"] is None
    assert found["model"] == {"verdict": None, "report": False} and found["correct"] is None
    assert job(client, "new.toml")["state"] == "new"
    np.testing.assert_array_equal(image(client, "/stacks/new.toml/slice?of=before&index=0"), block()[12])
    assert client.raw("GET", "/stacks/new.toml/slice?of=after&index=0")[0] == 404


@pytest.mark.slow
def test_slices_are_shown_before_and_after_their_correction(client: Client, finished: Path) -> None:
    lab = finished
    found = client("GET", "/stacks/block.toml")
    assert "print incorrectly" in found["model"]["verdict"]["sentence"] and not found["model"]["verdict"]["prints"]
    assert "of the height errors" in found["correct"]["verdict"]["sentence"] and found["correct"]["verdict"]["prints"]
    assert job(client, "block.toml")["state"] == "proved"
    np.testing.assert_array_equal(image(client, "/stacks/block.toml/slice?of=before&index=12"), block()[12])
    with open_stack(lab / "slices-corrected") as stack:
        for index in (21, len(stack) - 1):
            shown = image(client, f"/stacks/block.toml/slice?of=after&index={index}")
            np.testing.assert_array_equal(shown, stack[index : index + 1][0])
        assert not np.array_equal(stack[21:22][0], block()[21])
        assert client.raw("GET", f"/stacks/block.toml/slice?of=after&index={len(stack)}")[0] == 400
    for of in ("model", "correct"):
        assert b"Cure-through" in client.raw("GET", f"/stacks/block.toml/report?of={of}")[1]
    (lab / "block.toml").write_text(STACK.replace("180 mm/h", "90 mm/h"))
    changed = client("GET", "/stacks/block.toml")
    assert job(client, "block.toml")["state"] == "changed" and changed["model"]["verdict"] is None
    (lab / "block.toml").write_text(STACK)


def test_slices_elsewhere_are_not_shown(client: Client, lab: Path) -> None:
    """Nor slices in a folder of the workspace, nor those that are gone; the job is shown without them."""
    for place in (lab / "stacks" / "s", lab / "s-corrected"):  # the latter of other slices
        place.mkdir(parents=True)
        (place / "1.png").write_bytes(encode(block()[12], ".png"))
    for path in ("../outside", str(lab / "slices"), "film.vam/../slices", "stacks/s", "gone"):
        (lab / "other.toml").write_text(STACK.replace('"slices"', json.dumps(path)))
        found = client("GET", "/stacks/other.toml")
        assert found["before"] is None and not found["model"]["report"]
        assert path != "stacks/s" or found["after"] is None
        assert client.raw("GET", "/stacks/other.toml/slice?of=before&index=0")[0] == 404
    (lab / "other.toml").unlink()


def test_tasks_of_webs_and_stacks_are_their_commands(client: Client) -> None:
    solve = {"kind": "solve", "job": "block.toml", "device": "numpy", "fresh": True}
    made = client("POST", "/tasks", solve, 201)
    task = client.studio.engine.tasks.one(made["id"])
    expected = ["curethrough", "correct", "block.toml", "--out", "slices-corrected", "--report",
                "slices-corrected.html", "--overwrite", "--set", 'correct.device="numpy"']  # fmt: skip
    assert task.facts["arguments"] == expected
    model = client("POST", "/tasks", {"kind": "model", "job": "block.toml"}, 201)
    facts = client.studio.engine.tasks.one(model["id"]).facts
    assert facts["arguments"] == ["curethrough", "model", "block.toml", "--report", "block-model.html"]
    prove = client("POST", "/tasks", {"kind": "prove", "result": "film.vam", "device": "numpy"}, 201)
    facts = client.studio.engine.tasks.one(prove["id"]).facts
    assert facts["arguments"] == ["prove", "film.vam", "--device", "numpy", "--report", "film.html"]
    client("POST", "/tasks", {"kind": "solve", "job": "film.toml"}, 409)  # it is complete
    for each in (made, model, prove):
        client("POST", f"/tasks/{each['id']}/cancel")


@pytest.mark.slow
def test_the_page_shows_a_web_and_a_stack(client: Client, finished: Path) -> None:
    from playwright.sync_api import sync_playwright

    with sync_playwright() as tools:
        page, wrong = needs.page(tools, viewport={"width": 1280, "height": 860}), list[str]()
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.on("console", lambda said: wrong.append(said.text) if "Policy" in said.text else None)
        page.goto(f"{client.studio.url}#results/film.vam/look")
        page.get_by_role("img", name="The film about its roller").wait_for()
        page.get_by_text("window: film lit at one moment").wait_for()
        page.get_by_label("Focus plane", exact=True).select_option("1")
        page.locator('img.film[src*="plane=1"]').wait_for()
        page.get_by_role("button", name="Play", exact=True).click()
        page.get_by_role("button", name="Pause", exact=True).click()
        page.frame_locator("iframe").get_by_role("heading", name="Along the web").wait_for()
        page.goto(f"{client.studio.url}#jobs/block.toml/look")
        page.get_by_role("img", name="after the correction").wait_for()
        page.get_by_role("slider", name="Slice").fill("12")
        page.locator('img[src*="of=after&index=12"]').wait_for()
        page.frame_locator("iframe").first.get_by_role("heading", name="Cross-sections").wait_for()
        for place in ("jobs/block.toml/look", "results/film.vam/look", "jobs/film.toml/part"):
            page.evaluate(f"location.hash = '#{place}'")
            page.locator("#panel h2, #panel .head").first.wait_for()
            page.wait_for_timeout(1000)
            assert not (faults := axe.serious(page)), "\n".join(faults)
        page.evaluate("location.hash = '#jobs/block.toml/look'")
        page.get_by_role("button", name="Correct again").click()
        page.get_by_role("button", name="Correcting").wait_for()
        task = client("GET", "/tasks")["tasks"][0]
        assert (task["kind"], task["request"]["fresh"]) == ("solve", True) and not wrong, wrong
