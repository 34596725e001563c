"""The page and its server together: a job is solved, judged, exposed and run dry from the browser."""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import needs
import numpy as np
import pytest
import trimesh
from studio_client import BOAT, Client

import vamgpu
from vamgpu.hosts.rigs.config import EMULATED

LONGEST = 250_000
"""Longest wait for a task on a busy machine [ms]."""
COARSE = BOAT.replace('"250 um"', '"500 um"').replace("angles = 40", "angles = 20").replace("= 12\n", "= 6\n")
SWITCHES = ["--no-sandbox", "--enable-unsafe-swiftshader", "--use-angle=swiftshader", "--ignore-gpu-blocklist"]


@pytest.fixture
def page(client: Client, tmp_path: Path) -> Iterator[Any]:
    from playwright.sync_api import sync_playwright

    (tmp_path / "lab" / "boat.toml").write_text(COARSE, encoding="utf-8")
    with sync_playwright() as tools:
        browser = tools.chromium.launch(executable_path=needs.browser(), args=SWITCHES, timeout=needs.WAIT)
        made = browser.new_page(viewport={"width": 1280, "height": 860})
        made.set_default_timeout(LONGEST)
        wrong: list[str] = []
        made.on("pageerror", lambda error: wrong.append(str(error)))
        made.on("console", lambda said: wrong.append(said.text) if "Security Policy" in said.text else None)
        made.goto(client.studio.url)
        yield made
        assert not wrong, wrong


def test_the_scene_states_the_cylinder_that_every_angle_lights(client: Client) -> None:
    text = BOAT.replace('pitch = "250 um"\n\n[turntable]', 'pitch = "250 um"\npixels = [60, 40]\n\n[turntable]')
    assert client("PUT", "/jobs/wide.toml", {"text": text})["errors"] == []
    scene = client("GET", "/jobs/wide.toml/scene")
    assert scene["beam"]["reach"] == pytest.approx(0.5 * 60 * 0.25 / 1.49962, rel=1e-3)  # refracted once at the wall
    assert scene["vessel"]["lit"] == pytest.approx(12.4 / 1.49962, rel=1e-6)


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_job_is_solved_judged_and_run_dry_from_the_page(client: Client, page: Any, tmp_path: Path) -> None:
    page.get_by_role("heading", name="Size").wait_for()
    page.get_by_role("tab", name="Machine and resin").click()
    wall = page.get_by_label("vial wall", exact=True)
    wall.fill("-1 mm")
    wall.press("Enter")
    page.locator(".key", has=wall).locator(".error").wait_for()
    wall.fill("1.1 mm")
    wall.press("Enter")
    page.get_by_text("saved", exact=True).wait_for()
    text = (tmp_path / "lab" / "boat.toml").read_text()
    assert re.search(r'wall = "1\.1 mm"', text) and text.count("\n") >= COARSE.count("\n")

    page.get_by_role("tab", name="Solve").click()
    page.locator('[data-key="device"]').select_option(vamgpu.devices()[0])
    page.get_by_role("button", name="Solve", exact=True).click()
    page.get_by_text("Simulate · boat.vam").first.wait_for()
    page.get_by_role("button", name="Show the result").wait_for()
    page.get_by_role("tab", name="Look").click()
    page.get_by_test_id("verdict").wait_for()
    result = client("GET", "/results/boat.vam")
    assert page.get_by_test_id("verdict").text_content() == result["verdict"]["sentence"]

    page.get_by_test_id("live").get_by_text("of the part prints").wait_for()
    slider = page.get_by_label("Exposure", exact=True)
    slider.fill("0.8")
    page.get_by_test_id("exact").get_by_text("All voxels").wait_for()
    exact = client("GET", "/results/boat.vam/exposure?dose=0.8")
    said = page.get_by_test_id("exact").text_content()
    assert said.startswith(f"All voxels: {exact['missing']} missing, {exact['excess']} in excess")
    share = float(re.search(r"([\d.]+) % of the part", page.get_by_test_id("live").text_content())[1]) / 100  # type: ignore[index]
    assert share == pytest.approx(1 - exact["missing"] / result["scores"]["in_voxels"], abs=0.05)

    page.get_by_role("tab", name="Print").click()
    page.get_by_role("button", name="Start the dry run").click()
    page.locator(".task .mark.good").wait_for()
    page.locator(".prints li").first.wait_for()
    assert client("GET", "/runs")["runs"][0]["state"] == "complete"

    (tmp_path / "lab" / "lab.toml").write_text(EMULATED, encoding="utf-8")
    page.locator('[data-key="rig"] option[value="lab.toml"]').wait_for(state="attached")
    page.locator('[data-key="rig"]').select_option("lab.toml")
    page.get_by_text("no light is switched on").wait_for()
    page.locator('[data-key="turns"]').fill("40")
    page.locator('[data-key="turns"]').press("Enter")
    page.locator('[data-key="confirm"]').fill("boat.vam")
    if page.locator('[data-key="anyway"]').is_visible():
        page.locator('[data-key="anyway"]').check()
    page.get_by_role("button", name="Start the print").click()
    print_page = page.frame_locator("iframe")
    for state, act in (("printing", "pause"), ("paused", "resume"), ("printing", "")):
        is_now(client, state)
        if act:
            print_page.get_by_role("button", name=act, exact=True).click()
    print_page.get_by_test_id("stop").click()
    is_now(client, "cancelled")
    task = next(each for each in client("GET", "/tasks")["tasks"] if each["kind"] == "print")
    ended = client.ended(task)
    assert ended["state"] == "cancelled" and ended["progress"]["share"] < 1.0
    page.locator(".prints li", has_text="emergency stop at the panel").wait_for()
    assert client("GET", "/runs")["runs"][0]["state"] == "cancelled"


def is_now(client: Client, state: str) -> None:
    """Wait for a state of the print."""
    end = time.monotonic() + LONGEST / 1000
    while client("GET", "/print")["state"] != state:
        assert time.monotonic() < end, client("GET", "/print")
        time.sleep(0.1)


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_roles_in_names_are_taken_at_a_click(client: Client, page: Any, tmp_path: Path) -> None:
    block, rod = trimesh.creation.box((6, 6, 8)), trimesh.creation.cylinder(1.0, 10.0, sections=32)
    scene = trimesh.Scene({"grip": block, "insert rod": rod, "zero dose": rod.copy().apply_translation((2, 2, 0))})
    scene.units = "millimeter"
    scene.export(tmp_path / "named.3mf")
    client("POST", "/parts?name=named.3mf", (tmp_path / "named.3mf").read_bytes(), 201)
    client("POST", "/jobs", {"name": "named", "part": "named.3mf", "height": "5 mm"}, 201)
    page.goto(client.studio.url + "#jobs/named.toml/part")
    page.get_by_role("button", name="Use the roles in their names").click()
    page.get_by_label("Dose of zero dose").wait_for()
    made = client("GET", "/jobs/named.toml")
    said = [(each["name"], each["part"], each["role"], each.get("dose")) for each in made["fields"]["body"]]
    assert made["errors"] == [] and said == [
        ("grip", 1, "print", None), ("insert rod", 2, "insert", None), ("zero dose", 3, "keep out", 0.7)]  # fmt: skip
    assert page.get_by_role("button", name="Use the roles in their names").count() == 0
    text = made["text"][: made["text"].index("[[body]]")] + made["text"][made["text"].rindex("dose = 0.7") + 10 :]
    names = text + '\n[[body]]\nmesh = "named.3mf"\nroles = "names"\ndose = 0.7\n'
    assert client("PUT", "/jobs/named.toml", {"text": names, "etag": made["etag"]})["errors"] == []
    page.locator(".body").get_by_text("insert rod: insert").wait_for()


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_the_parts_of_one_file_get_their_roles(client: Client, page: Any, tmp_path: Path) -> None:
    block, pin = trimesh.creation.box((6, 6, 8)), trimesh.creation.cylinder(1.0, 10.0, sections=32)
    pin.apply_translation((5.0, 0.0, 3.0))
    scene = trimesh.Scene({"block": block, "pin": pin})
    scene.units = "millimeter"
    scene.export(tmp_path / "two.3mf")
    client("POST", "/parts?name=two.3mf", (tmp_path / "two.3mf").read_bytes(), 201)
    client("POST", "/jobs", {"name": "two", "part": "two.3mf", "height": "5 mm"}, 201)
    before, _ = client.arrays("/jobs/two.toml/mesh")
    page.goto(client.studio.url + "#jobs/two.toml/part")
    page.locator(".body").nth(1).wait_for()
    chosen = page.locator(".body").nth(1)
    chosen.get_by_text("pin").wait_for()
    page.locator("canvas.scene[data-drawn]").wait_for()
    page.wait_for_timeout(1500)
    view = page.locator("canvas.scene").bounding_box()
    page.mouse.click(view["x"] + 0.5 * view["width"], view["y"] + 0.5 * view["height"])
    page.locator(".body.on").wait_for()
    chosen.locator("select").select_option("keep out")
    page.get_by_label("Dose of pin").wait_for()
    made = client("GET", "/jobs/two.toml")
    assert made["errors"] == [] and [each["role"] for each in made["fields"]["body"]] == ["print", "keep out"]
    assert [each["part"] for each in made["fields"]["body"]] == [1, 2] and made["fields"]["body"][1]["dose"] == 0.7
    after, _ = client.arrays("/jobs/two.toml/mesh")
    for number in (0, 1):  # the bodies stay where the part was
        both = [np.unique(each["positions"][each["indices"][each["owner"] == number]].reshape(-1, 3), axis=0)
                for each in (before, after)]  # fmt: skip
        np.testing.assert_allclose(both[0].min(axis=0), both[1].min(axis=0), atol=2e-3)
        np.testing.assert_allclose(both[0].max(axis=0), both[1].max(axis=0), atol=2e-3)
    page.locator(".body").nth(1).locator("select").select_option("insert")
    page.get_by_label("Dose of pin").wait_for(state="detached")
    assert client("GET", "/jobs/two.toml")["errors"] == []
