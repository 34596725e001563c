"""The page and its server together: a job is solved, judged, exposed and run dry from the browser."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import needs
import pytest
from studio_client import BOAT, Client

LONGEST = 250_000
"""Longest wait for a task on a busy machine [ms]."""
SWITCHES = ["--no-sandbox", "--enable-unsafe-swiftshader", "--use-angle=swiftshader", "--ignore-gpu-blocklist"]


@pytest.fixture
def page(client: Client) -> Iterator[Any]:
    from playwright.sync_api import sync_playwright

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
    assert re.search(r'wall = "1\.1 mm"', text) and text.count("\n") >= BOAT.count("\n")

    page.get_by_role("tab", name="Solve").click()
    page.locator('[data-key="device"]').select_option("numpy")
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
    page.get_by_role("button", name="Run dry").click()
    page.locator(".task .mark.good").wait_for()
    page.locator(".prints li").first.wait_for()
    assert client("GET", "/runs")["runs"][0]["state"] == "complete"
