"""The widest window for a limited exposure time, and the dose outside the part."""

from __future__ import annotations

from profiling.gallery import scene
from profiling.gallery.picture import Fact, Picture, Table
from vamgpu.backend.device import Device
from vamgpu.methods import optimize, pareto
from vamgpu.reports import style


def sooner(
    device: Device, quick: bool = False, pitch: float = 0.4, angles: int = 90, evaluations: int = 300,
    irradiance: float = 0.65, critical_dose: float = 0.05,
) -> Picture:  # fmt: skip
    """The boat in the vial in air; irradiance of a full-on pixel in mW/mm², critical dose in mJ/mm³."""
    target = scene.boat(device, 1.2 if quick else pitch)
    A = scene.in_vial(target, 24 if quick else int(angles), device)
    most = 80 if quick else int(evaluations)
    plan = optimize(A, target, evaluations=4 * most, progress=False)
    points = pareto(plan, irradiance=irradiance, critical_dose=critical_dose, evaluations=most)
    figure, axes = style.sheet("ab", 4.2)
    seconds = [point.seconds for point in points]
    for panel, values, label, color in (
        ("a", [point.window for point in points], "strict process window", style.BLUE),
        ("b", [point.outside for point in points], "mean dose outside over that in the part", style.ORANGE),
    ):
        axes[panel].plot(seconds, values, "o-", color=color, ms=5)
        axes[panel].set(xlabel="exposure [s]", ylabel=label, xlim=(0, None))
    axes["a"].axhline(0, color=style.INK, lw=0.8)
    first, last = points[0], points[-1]
    facts = (
        Fact("widest window", first.window, "", 3), Fact("its exposure", first.seconds, "s", 3),
        Fact("window of the shortest exposure that prints", last.window, "", 3),
        Fact("the shortest exposure that prints", last.seconds, "s", 3),
    )  # fmt: skip
    table = Table(("patterns", "exposure [s]", "window", "dose outside over inside"), (".2f", "+.3f", ".3f"),
                  tuple((str(k + 1), (p.seconds, p.window, p.outside)) for k, p in enumerate(points)))  # fmt: skip
    caption = (
        "An exposure lasts until the dose midway between part and voids is the critical dose, with the brightest pixel "
        "full-on. Each point is the result of the default method within a time limit, started from the patterns of the "
        "previous point; the curve ends where no patterns print. If two windows are equally wide, use the shorter "
        "exposure. Doses are those before packing. `vam solve --pareto` draws this chart for a job."
    )
    return Picture(figure, caption, facts, table, plan.papers)
