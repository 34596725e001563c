"""Draw the live page in its states, the report of a live print and of three proofs; needs Playwright and Chromium.

``python -m profiling.gallery.pages [FOLDER]``
"""

from __future__ import annotations

import json
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

import vamgpu
from vamgpu.errors import BadInput
from vamgpu.hosts.panel import Panel
from vamgpu.hosts.records.state import Board, Estimated, ImageCheck, PrintState
from vamgpu.hosts.rigs.config import read_rig
from vamgpu.hosts.rigs.guarantees import guarantees
from vamgpu.live import LiveRecord, LiveSetup, SensorNoise, Truth, Turbidity, VirtualPrinter
from vamgpu.live.maps import cuts
from vamgpu.live.printer import CuringResin
from vamgpu.live.report import page as live_page
from vamgpu.printing.proof import Proof
from vamgpu.printing.scatter import ScatterReading
from vamgpu.targets import shapes

DESK, PHONE = (1100, 900), (360, 800)
SHEET: Any = {"width": 900, "height": 1200}
COLORS = 192
"""Of the pictures of proofs, which are large otherwise."""
KEPT = ("printing-vial", "held", "live", "phone")
"""Which stand in docs/; all others are drawn to be looked at."""
TUBE = Truth(inhibitor=0.75, lamp=0.9, across=0.3)
"""How the print of the report differs from its plan."""


def frame(angle: float, rows: int = 240, columns: int = 320) -> np.ndarray:
    """A ring and a bar, seen from an angle."""
    x, z = np.meshgrid(np.linspace(-1.6, 1.6, columns), np.linspace(-1.2, 1.2, rows))
    width = 0.25 + 0.6 * abs(np.cos(angle))
    ring = (np.hypot(x / width, z) < 0.9) & (np.hypot(x / width, z) > 0.5)
    return np.where(ring, 200, np.where(abs(z) < 0.08, 120, 0)).astype(np.uint8) * (abs(x) < 1.2)


def believed() -> dict[str, np.ndarray]:
    """Dose and conversion of a nut, as a print that is watched shows them."""
    x, y, z = np.meshgrid(*(np.linspace(-1.5, 1.5, n) for n in (48, 48, 32)), indexing="ij")
    away = np.maximum(np.abs(np.hypot(x, y) - 0.75) - 0.35, np.abs(z) - 0.8)
    dose = 0.35 + 0.75 / (1.0 + np.exp(12.0 * (away + 0.03)))
    part = (away < 0).astype(float)
    return {
        "dose; brightest is 1.5 times what solidifies": cuts(dose, part, 1.5),
        "conversion seen": cuts(np.clip(1.0 - np.exp(-4.0 * (dose - 0.65)), 0.0, 1.0), part, 1.0, "viridis"),
    }


def claims(rig: str = "emulated") -> list[dict[str, Any]]:
    """What a rig guarantees at a usual speed, as a print shows it."""
    return [one.record() for one in guarantees(read_rig(rig).setup, 40.0)]


def states() -> dict[str, tuple[tuple[int, int], dict[str, Any]]]:
    """The size of the page and the snapshot, by the name of its picture."""
    vial = {
        "state": "printing", "job": "benchy.vam", "slots": 14400, "slot": 5230, "frame": 190, "position": 5230.4,
        "light": True, "power": 0.8, "fill": 0.93, "margin": 214_000_000, "spent": 0.361, "left": 229.0,
        "lease": 1.0, "renewed": 0.04, "preview": frame(0.4), "polled": True, "period": 720, "interlock_closed": True,
        "guarantees": claims(),
    }  # fmt: skip
    dark = vial | {"light": False, "renewed": None}
    curve = [ScatterReading(float(t), 0.3 / (1 + np.exp((70 - t) / 9)), False) for t in range(0, 88)]
    web = {"job": "web.vam", "unit": "mm", "focus": -1.25, "position": 871.2, "slots": 0, "period": 0}
    bare = {"guarantees": claims("docs/rigs/vialux_zaber.toml"), "interlock_closed": None, "renewed": None}
    dry = {"rehearsed": True, "job": "dry run of benchy.vam"}
    good = [ImageCheck("images", t, 4.1 + (t * 37 % 11) / 3, 15.0) for t in range(1, 10)]
    good += [ImageCheck("conversion", t, 0.13 - 0.004 * t, 0.35) for t in range(3, 10)]
    wrong = [ImageCheck("images", t, v, 15.0) for t, v in enumerate((6.1, 7.0, 9.4, 13.8, 21.3), 1)]
    ended = dark | {"left": None}
    return {
        "standby": (DESK, {"job": "benchy.vam", "slots": 14400, "period": 720}),
        "dry-run": (DESK, vial | dry),
        "printing-bare": (DESK, vial | bare),
        "printing-vial": (DESK, vial | {"scatter": curve, "threshold": 0.35, "camera": frame(1.2) // 2 + 40}),
        "printing-web": (DESK, vial | web),
        "printing-two": (DESK, vial | {"job": "visible.vam uv.vam", "others": (frame(1.3),)}),
        "live": ((DESK[0], 1150), vial | {
            "slot": 6900, "position": 6900.4, "frame": 420, "left": 61.0, "spent": 0.712,
            "preview": frame(0.4), "camera": frame(1.2) // 2 + 40, "plan": 3, "stop": 13, "parameters": (
                Estimated("sensitivity", 0.812, 0.021, (0.6, 1.4)), Estimated("absorption", 1.131, 0.042, (0.8, 1.2)),
                Estimated("across", 0.062, 0.008, (-0.1, 0.1)), Estimated("inhibitor", 0.735, 0.03, (0.38, 1.62)),
                Estimated("estimated after turn", 9, 0.0), Estimated("expected stop [turn]", 13, 0.0),
            ), "maps": believed(), "checks": good,
        }),
        "live-doubted": (DESK, vial | {
            "camera": frame(1.2) // 2 + 40, "plan": 3, "stop": 16, "checks": wrong,
            "live": "the images are not used: images differ from any field by 21.3 times their noise (expected at most "
            "15): check open field, noise, orientation and place of the camera; the planned light continues",
        }),
        "paused": (DESK, dark | {"state": "paused"}),
        "held": (DESK, dark | {
            "state": "held",
            "message": "the light went off: the controller closed the light: interlock; 9169 of 14400 slots remain",
            "interlock_closed": False, "deadline": time.monotonic() + 24.9, "doubt": ((5230, 5231),),
        }),
        "complete": (DESK, ended | {"state": "complete", "slot": 14399, "spent": 0.99}),
        "incomplete": (DESK, ended | {"state": "incomplete", "slot": 14399, "dark": 7, "message": "7 lack light"}),
        "cancelled": (DESK, ended | {"state": "cancelled", "message": "emergency stop at the panel"}),
        "error": (DESK, ended | {"state": "error", "message": "the motor stalled at 5230.4 deg; look at its cable"}),
        "lost": (DESK, vial),
        "phone": (PHONE, vial | {"others": (frame(1.3),)}),
        "phone-lost": (PHONE, vial),
        "phone-dry": (PHONE, vial | dry | {"checks": good}),
    }  # fmt: skip


def runs(place: Path) -> None:
    """Run folders of earlier prints."""
    now = time.time()
    told = (
        ("benchy-3.run", "benchy.vam", "cancelled", "emergency stop at the panel", 4000, 131),
        ("benchy-2.run", "benchy.vam", "complete", "scatter density 0.352 reached 0.35 after 212.4 s", 9000, 214),
        ("ear.run", "ear.vam", "error", "the motor stalled at 212.8 deg; look at its cable", 90000, 61),
    )
    for name, job, state, message, ago, seconds in told:
        (folder := place / name).mkdir()
        began = now - ago
        (folder / "run.json").write_text(json.dumps({"jobs": [job]}))
        (folder / "events.jsonl").write_text(json.dumps({"wall": began}) + "\n")
        (folder / "state.json").write_text(json.dumps({"state": state, "message": message, "wall": began + seconds}))
        (folder / "report.html").write_text("")
        os.utime(folder / "state.json", (began, began))


def shoot(out: Path, wanted: tuple[str, ...] = ()) -> list[Path]:
    """Draw the requested pages, or all."""
    from playwright.sync_api import sync_playwright

    drawn = []
    with tempfile.TemporaryDirectory() as place, sync_playwright() as tools:
        runs(Path(place))
        browser = tools.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        for name, (size, fields) in states().items():
            if wanted and name not in wanted:
                continue
            board = Board()
            for button in ("pause", "resume", "cancel"):
                board.button(button, lambda: None)
            page = browser.new_page(viewport={"width": size[0], "height": size[1]})
            with Panel(board, runs=place) as panel:
                state = PrintState(fields.get("state", "standby"))
                polled = time.monotonic() if "polled" in fields else None
                board.show(**fields | {"state": state, "polled": polled})
                page.goto(panel.url)
                page.get_by_test_id("history").locator("li").first.wait_for()
                page.wait_for_function("[...document.images].every((image) => image.complete)")
                if polled is not None:
                    board.show(polled=time.monotonic())
                page.wait_for_timeout(400)
                drawn.append(out / f"page-{name}.png")
                page.screenshot(path=drawn[-1])
            if name.endswith("lost"):
                page.get_by_test_id("lost").wait_for()
                page.wait_for_timeout(300)
                page.screenshot(path=drawn[-1])
            wide = page.evaluate("document.documentElement.scrollWidth")
            if wide > size[0]:
                raise BadInput(f"the page {name!r} is {wide} pixels wide; expected {size[0]} at most")
            page.close()
        browser.close()
    return drawn


def proofs() -> Iterator[tuple[str, Proof]]:
    """A gear in a vial: patterns that print, patterns that do not, and the first with extra lit columns beside."""
    vial = vamgpu.Vial(radius=12.4, wall=1.0, resin_index=1.49962, wall_index=1.473, absorption=0.05)
    beam = vamgpu.Beam((54, 32), 0.4)
    width = vamgpu.resin_pixel(beam, vial)[0]
    target = vamgpu.Target.from_mesh(shapes.build("gear_base"), height=6.0, pitch=width)
    A = vamgpu.Projection(target.grid, beam, vamgpu.Turntable(60), vial)
    good, bad = vamgpu.optimize(A, target, iterations=40), vamgpu.optimize(A, target, "fbp")
    light = good.sinogram.numpy().copy()
    light[:, :3] = light.max()
    stray = replace(good, sinogram=A.device.upload(light))
    for name, plan in (("prints", good), ("not", bad), ("stray", stray)):
        lamp: dict[str, Any] = {"irradiance": "65 mW/cm2", "critical_dose": "50 mJ/cm3"}
        yield name, vamgpu.simulate(A, vamgpu.pack(plan), target, **lamp)


def shoot_proofs(out: Path) -> list[Path]:
    """Draw the head of each proof's report, with the surface in three dimensions below it."""
    from playwright.sync_api import sync_playwright

    drawn = []
    with tempfile.TemporaryDirectory() as place, sync_playwright() as tools:
        switches = ["--no-sandbox", "--enable-unsafe-swiftshader", "--use-angle=swiftshader"]
        browser = tools.chromium.launch(executable_path=shutil.which("chromium"), args=switches)
        page = browser.new_page(viewport=SHEET)
        for name, proof in proofs():
            page.goto(proof.report(Path(place) / f"{name}.html").as_uri())
            page.add_style_tag(content=".summary { display: none } #solid { height: 20rem }")
            page.wait_for_timeout(1500)
            drawn.append(out / f"proof-{name}.png")
            shown = page.locator("section.solid").bounding_box()
            assert shown is not None
            width, height = SHEET["width"], shown["y"] + shown["height"] + 20
            page.screenshot(path=drawn[-1], full_page=True, clip={"x": 0, "y": 0, "width": width, "height": height})
            Image.open(drawn[-1]).convert("RGB").quantize(COLORS, dither=Image.Dither.NONE).save(
                drawn[-1], optimize=True
            )
        browser.close()
    return drawn


def watched(folder: Path) -> LiveRecord:
    """A tube that prints in used resin with a displaced axis, and whose camera is pushed aside after turn 13."""
    vial, red = (vamgpu.Vial(8.0, 0.5, 1.5, 1.5, 1.0, absorption=a) for a in (0.1, 0.0))
    setup = LiveSetup(
        (32, 32, 16), 0.13, (64, 16), 0.13, 60, vial, red, 800.0, SensorNoise(0.8, 0.01, 10), CuringResin(),
        Turbidity((0.0, 1.0), (0.0, 0.25)), 1.3, 16, 32, evaluations=6.0,
    )  # fmt: skip
    plan = setup.projection(vial)
    x, y, z = np.meshgrid(*plan.grid.axes(), indexing="ij")
    part = ((abs(np.hypot(x, y) - 1.1) < 0.5) & (abs(z) < 0.7)).astype(np.float32)
    light = (vamgpu.optimize(plan, part, "lbfgs", 20, progress=False).sinogram.numpy() / 16).astype(np.float32)
    record = LiveRecord(folder)
    printer = VirtualPrinter(plan, setup.camera(), setup.resin, setup.turbidity, TUBE)
    loop = record.begin(setup, part, light)
    state, action = loop.start(), "keep"
    while action != "stop":
        printer.turn(printer.dose(np.asarray(state.light)))
        images = np.roll(printer.through(), 5 * (printer.turns > 13), axis=2)
        state, decision = loop.decide(state, images)
        record.add(images, decision, effective=decision.turn + 1)
        action = decision.action
    return record


def shoot_live(out: Path) -> Path:
    """Draw the report of a live print whose images stop to decide."""
    from playwright.sync_api import sync_playwright

    with tempfile.TemporaryDirectory() as place, sync_playwright() as tools:
        record = watched(Path(place) / "tube.run" / "live")
        browser = tools.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1000, "height": 1240})
        page.goto(live_page(record, TUBE).write(Path(place) / "live.html").as_uri())
        page.screenshot(path=out / "report-live.png")
        browser.close()
    Image.open(out / "report-live.png").convert("RGB").quantize(COLORS, dither=Image.Dither.NONE).save(
        out / "report-live.png", optimize=True
    )
    return out / "report-live.png"


if __name__ == "__main__":
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else None
    shown = folder or Path("docs")
    for image in (*shoot(shown, () if folder else KEPT), shoot_live(shown), *shoot_proofs(shown)):
        print(f"drew {image}")
