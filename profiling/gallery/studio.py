"""Draw the page of Studio on a job that it solves; needs Playwright and Chromium.

``python -m profiling.gallery.studio [FOLDER]``
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from pathlib import Path
from typing import Any

from PIL import Image

from vamgpu.studio.server import Studio
from vamgpu.targets import shapes

SIZE: Any = {"width": 1360, "height": 850}
COLORS = 256
SWITCHES = ["--no-sandbox", "--enable-unsafe-swiftshader", "--use-angle=swiftshader"]
LONGEST = 900_000
"""Longest wait for a solve or a simulation [ms]."""
JOB = """\
# A gear with two shafts, in a vial of 25 mm
[target]
mesh = "gear.stl"
height = "6 mm"

[vial]
radius = "12.4 mm"     # measured with a caliper
wall = "1 mm"
resin_index = 1.49962
wall_index = 1.473
absorption = "0.05 /mm"

[beam]
pixels = [108, 64]
pitch = "200 um"

[turntable]
angles = 90

[solve]
iterations = 40

[print]
irradiance = "65 mW/cm2"
critical_dose = "50 mJ/cm3"
"""


def shot(page: Any, out: Path, name: str) -> Path:
    """A picture of the page with few colors."""
    page.wait_for_timeout(1500)
    path = out / f"studio-{name}.png"
    page.screenshot(path=path)
    small = Image.open(path).convert("RGB").quantize(COLORS, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
    small.save(path, optimize=True)
    return path


def shoot(out: Path) -> list[Path]:
    """Draw the five tabs; the job is solved and simulated between the third and the fourth."""
    from playwright.sync_api import sync_playwright

    drawn = []
    with tempfile.TemporaryDirectory() as place, sync_playwright() as tools:
        (lab := Path(place) / "lab").mkdir()
        shapes.build("gear_base").save(lab / "gear.stl")
        (lab / "gear.toml").write_text(JOB)
        browser = tools.chromium.launch(executable_path=shutil.which("chromium"), args=SWITCHES)
        page = browser.new_page(viewport=SIZE)
        page.set_default_timeout(LONGEST)
        with Studio(lab / "gear.toml") as studio:
            page.goto(studio.url)
            page.get_by_role("heading", name="Size").wait_for()
            drawn.append(shot(page, out, "part"))
            for tab in ("Machine and resin", "Solve"):
                page.get_by_role("tab", name=tab).click()
                if tab == "Solve":
                    page.get_by_role("button", name="Solve", exact=True).click()
                    page.get_by_role("heading", name="Dose so far").wait_for()
                    page.wait_for_timeout(3000)
                drawn.append(shot(page, out, "job" if tab != "Solve" else "solve"))
            page.get_by_text("Simulate · gear.vam").first.wait_for()
            page.get_by_role("button", name="Show the result").wait_for()
            for tab, ready in (("Look", "of the part prints"), ("Print", "how sure")):
                page.get_by_role("tab", name=tab).click()
                page.get_by_text(ready).first.wait_for()
                drawn.append(shot(page, out, tab.lower()))
        browser.close()
    return drawn


if __name__ == "__main__":
    for image in shoot(Path(sys.argv[1]) if len(sys.argv) > 1 else Path("docs")):
        print(f"drew {image}")
