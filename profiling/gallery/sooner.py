"""The widest window for a limited exposure time, and the dose outside the part."""

from __future__ import annotations

from profiling.gallery import scene
from profiling.gallery.picture import Fact, Picture, Table
from vamgpu.backend.device import Device
from vamgpu.methods import SurfaceRamp, optimize, pareto
from vamgpu.reports import style


def sooner(
    device: Device, quick: bool = False, pitch: float = 0.4, angles: int = 90, evaluations: int = 300,
    irradiance: float = 0.65, critical_dose: float = 0.05, brightest: float = 8.0,
) -> Picture:  # fmt: skip
    """The boat in the vial in air, by the default and with another limit of light.

    irradiance: of a full-on pixel [mW/mm²].  critical_dose: [mJ/mm³].  brightest: limit of pixels of the second series.
    """
    target = scene.boat(device, 1.2 if quick else pitch)
    A = scene.in_vial(target, 24 if quick else int(angles), device)
    most = 80 if quick else int(evaluations)
    usual, wide = SurfaceRamp(), SurfaceRamp(brightest=float(brightest))
    plans = {f"brightest = {method.brightest:g}": optimize(A, target, method, evaluations=4 * most, progress=False)
             for method in (wide, usual)}  # fmt: skip
    lamp = {"irradiance": irradiance, "critical_dose": critical_dose}
    series = {name: pareto(plan, evaluations=most, **lamp) for name, plan in plans.items()}
    figure, axes = style.sheet("ab", 4.2)
    for (name, points), color in zip(series.items(), (style.ORANGE, style.BLUE), strict=True):
        seconds = [point.seconds for point in points]
        label = f"{name}, the default" if name.endswith(f"{usual.brightest:g}") else name
        axes["a"].plot(seconds, [point.window for point in points], "o-", color=color, ms=5, label=label)
        axes["b"].plot(seconds, [point.outside for point in points], "o-", color=color, ms=5, label=label)
    axes["a"].set(title="Window one pixel from the surface", ylabel="window over greatest dose")
    axes["b"].set(title="Mean dose outside the part over that in it", ylabel="ratio of mean doses")
    for panel in "ab":
        axes[panel].set(xlabel="exposure [s]", xlim=(0, None))
        axes[panel].legend(loc="center right" if panel == "a" else "upper right")
    axes["a"].axhline(0, color=style.INK, lw=0.8)
    (slow, soon), last = (points[0] for points in series.values()), series[f"brightest = {usual.brightest:g}"][-1]
    facts = (
        Fact("window of the default", soon.window, "", 3), Fact("exposure of the default", soon.seconds, "s", 3),
        Fact(f"window with brightest = {brightest:g}", slow.window, "", 3),
        Fact(f"exposure with brightest = {brightest:g}", slow.seconds, "s", 3),
        Fact("window of the shortest exposure that prints", last.window, "", 3),
        Fact("the shortest exposure that prints", last.seconds, "s", 3),
    )  # fmt: skip
    table = Table(
        ("limit of pixels, and number of the patterns", "exposure [s]", "window", "dose outside over inside"),
        (".2f", "+.3f", ".3f"), tuple((f"{name}, {k + 1}", (p.seconds, p.window, p.outside))
                                      for name, points in series.items() for k, p in enumerate(points)))  # fmt: skip
    caption = (
        "The widest window that patterns reach within an exposure time: a shorter exposure leaves less of it. An "
        "exposure lasts until the dose midway between part and voids is the critical dose, with the brightest pixel "
        "full-on. The first point of a series is a plan of the default method, whose pixels are at most `brightest` "
        "times as bright as the mean of the initial patterns, weighted by their own light. Each further point is the "
        "result within a shorter time, started from the patterns of the previous point; a series ends where no "
        "patterns print. If two windows are equally wide, use the shorter exposure. Doses are those before packing. "
        "`vam solve --pareto` draws this chart for a job."
    )
    return Picture(figure, caption, facts, table, plans[f"brightest = {usual.brightest:g}"].papers)
