"""Draw the page of Studio on a job that it solves, and a film of a minute; needs Playwright and Chromium.

``python -m profiling.gallery.studio [FOLDER]``
"""

from __future__ import annotations

import io
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
FILM, SECONDS, QUALITY = (816, 510), 60.0, 45
"""Size of the film [pixels], its length [s] and the quality of its images [%]."""
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


class Film:
    """Images of the page, and how long each one is shown relative to the others."""

    def __init__(self, page: Any) -> None:
        self.page, self.images, self.shares = page, list[Image.Image](), list[float]()

    def take(self, share: float, wait: float = 0.0) -> None:
        """Take an image after a pause [s]."""
        self.page.wait_for_timeout(1000 * wait)
        image = Image.open(io.BytesIO(self.page.screenshot())).convert("RGB")
        self.images.append(image.resize(FILM, Image.Resampling.LANCZOS))
        self.shares.append(share)

    def slide(self, name: str, values: Any) -> None:
        """Move a slider through values."""
        for value in values:
            self.page.get_by_label(name, exact=True).fill(f"{value:.3f}")
            self.take(0.3, 0.1)

    def turn(self, count: int) -> None:
        """Turn the three-dimensional view."""
        self.page.locator("canvas.scene").focus()
        for _ in range(count):
            self.page.keyboard.press("ArrowRight")
            self.take(0.3, 0.1)

    def until(self, ready: Any, pause: float) -> None:
        """Take images until something is there."""
        while not ready.is_visible():
            self.take(0.6, pause)

    def write(self, path: Path) -> Path:
        """Write the film, `SECONDS` long."""
        times = [round(1000 * SECONDS * share / sum(self.shares)) for share in self.shares]
        first, *rest = self.images
        first.save(path, save_all=True, append_images=rest, duration=times, loop=0, quality=QUALITY, method=4,
                   minimize_size=True)  # fmt: skip
        return path


def shoot(out: Path) -> list[Path]:
    """Draw the five tabs and the film; the job is solved and simulated between the third tab and the fourth."""
    from playwright.sync_api import sync_playwright

    with tempfile.TemporaryDirectory() as place, sync_playwright() as tools:
        (lab := Path(place) / "lab").mkdir()
        shapes.build("gear_base").save(lab / "gear.stl")
        (lab / "gear.toml").write_text(JOB)
        browser = tools.chromium.launch(executable_path=shutil.which("chromium"), args=SWITCHES)
        page = browser.new_page(viewport=SIZE)
        page.set_default_timeout(LONGEST)
        film = Film(page)
        with Studio(lab / "gear.toml") as studio:
            page.goto(studio.url)
            drawn = [*_made(page, out, film), *_solved(page, out, film), *_judged(page, out, film)]
        browser.close()
    return [*drawn, film.write(out / "studio.webp")]


def _made(page: Any, out: Path, film: Film) -> list[Path]:
    """The part is turned in its vial, and a value of the machine is changed."""
    page.get_by_role("heading", name="Size").wait_for()
    part = shot(page, out, "part")
    film.take(3.0)
    film.turn(10)
    for _ in range(2):
        page.get_by_role("button", name="Turn about x by 90°").click()
        film.take(1.0, 1.5)
    page.get_by_role("button", name="As drawn").click()
    page.get_by_role("tab", name="Machine and resin").click()
    page.get_by_label("vial wall", exact=True).wait_for()
    job = shot(page, out, "job")
    film.take(3.0)
    for value in ("-1", "1"):
        page.get_by_label("vial wall", exact=True).fill(value)
        page.get_by_label("vial wall", exact=True).press("Enter")
        film.take(2.0, 1.0)
    return [part, job]


def _solved(page: Any, out: Path, film: Film) -> list[Path]:
    """The job is solved and simulated."""
    page.get_by_role("tab", name="Solve").click()
    page.get_by_role("button", name="Solve", exact=True).click()
    film.until(page.get_by_role("heading", name="Dose so far"), 2.0)
    page.wait_for_timeout(3000)
    drawn = shot(page, out, "solve")
    film.until(page.get_by_text("Simulate · gear.vam").first, 3.0)
    film.until(page.get_by_role("button", name="Show the result"), 4.0)
    film.take(2.0)
    return [drawn]


def _judged(page: Any, out: Path, film: Film) -> list[Path]:
    """The print is examined, and run dry."""
    page.get_by_role("tab", name="Look").click()
    page.get_by_text("of the part prints").first.wait_for()
    look = shot(page, out, "look")
    film.take(4.0)
    film.slide("Exposure", (1.0 + 0.05 * k for k in (-1, -2, -4, -2, 0, 2, 4, 6, 3, 0)))
    film.slide("Place of the slice", (0.5 + 0.05 * k for k in (1, 3, 5, 7, 4, 1, -2, -5, -7, 0)))
    page.locator("canvas.scene").scroll_into_view_if_needed()
    film.turn(8)
    page.get_by_role("button", name="Play").scroll_into_view_if_needed()
    page.get_by_role("button", name="Play").click()
    for _ in range(8):
        film.take(0.4, 0.2)
    page.get_by_role("tab", name="Print").click()
    page.get_by_text("how sure").first.wait_for()
    drawn = shot(page, out, "print")
    film.take(4.0)
    page.get_by_role("button", name="Start the dry run").click()
    film.until(page.locator(".task .mark.good"), 4.0)
    film.take(4.0, 1.0)
    return [look, drawn]


if __name__ == "__main__":
    for image in shoot(Path(sys.argv[1]) if len(sys.argv) > 1 else Path("docs")):
        print(f"drew {image}")
