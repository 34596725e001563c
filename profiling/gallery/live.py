"""A print in aged resin, with a weak lamp and an axis off center, that is watched and replanned."""

from __future__ import annotations

import numpy as np

from profiling.gallery.picture import Fact, Picture
from profiling.live_table import PLANNED, Bench
from vamgpu.backend.device import Device
from vamgpu.live.film import drawn
from vamgpu.live.printer import GENERATIONS, Truth, VirtualPrinter
from vamgpu.methods.papers import AUTOMATIC_EXPOSURE
from vamgpu.metrics import score


def live(device: Device, quick: bool = False, generation: int = 3, lamp: float = 0.9, along_z: float = 0.05) -> Picture:
    """generation: of the resin, of five. lamp: its power over the plan's. along_z: rise of gain from middle to top."""
    bench = Bench(24 if quick else 32, 40 if quick else 60, device.name)
    truth = Truth(inhibitor=GENERATIONS[generation - 1] / GENERATIONS[0], lamp=lamp, along_z=along_z)
    timed = bench.printer(truth, 0)
    bench.ended("timer", timed)
    printer, decisions, frames = bench.printer(truth, 0), [], []
    state, dose, action = bench.loop.start(), bench.dose(printer), "keep"
    while action != "stop":
        printer.turn(dose)
        frames.append(printer.through())
        state, decision = bench.loop.decide(state, frames[-1])
        decisions.append(decision)
        action = decision.action
        dose = printer.dose(state.light) if action == "swap" else dose
    facts = (
        Fact("overlap when not watched, with the exposure time of fresh resin", _overlap(bench, timed), digits=3),
        Fact("overlap when watched", _overlap(bench, printer), digits=4),
        Fact("RMS distance of the surfaces, watched", 1e3 * _off(bench, printer), "µm", 2),
        Fact("the same for the plan in fresh resin", bench.known["fresh_um"], "µm", 2),
        Fact("turns that were lit", float(printer.turns), "", 2, float(PLANNED), "the plan", "≤"),
        Fact("inhibitor found, relative to fresh resin", decisions[-1].inhibitor, "", 3, truth.inhibitor, "the truth"),
        Fact("estimated gain along z", decisions[-1].parameters["along_z"][0], "", 2, along_z, "the truth"),
    )
    caption = (
        "A camera looks through the vial while it turns. After each turn the library reconstructs the conversion from "
        "its images, estimates lamp, resin and axis, and replans the remaining turns; the figure shows the decision "
        "after the first replanning. The simulated resin, rays and camera share only the geometry with the plan."
    )
    middle = next(k for k, each in enumerate(decisions) if each.action == "swap") + 1
    shown = min(middle, len(decisions) - 1)
    figure = drawn(bench.part, frames[shown], decisions[: shown + 1], bench.setup.open_field, len(decisions))
    return Picture(figure, caption, facts, None, (AUTOMATIC_EXPOSURE,))


def _overlap(bench: Bench, printer: VirtualPrinter) -> float:
    device, printed = bench.plan.device, printer.printed().astype(np.float32)
    return float(score(device.upload(printed), device.upload(bench.part), threshold=bench.setup.resin.gel).iou)


def _off(bench: Bench, printer: VirtualPrinter) -> float:
    return bench.surface(printer.printed(), bench.setup.resin.gel)
