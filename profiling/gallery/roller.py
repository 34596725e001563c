"""A film about a roller: rays, the energy they leave in it, and the same in the film laid flat."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from profiling.gallery.picture import Fact, Picture
from vamgpu.backend.device import Device
from vamgpu.geometry import Beam
from vamgpu.methods.papers import ROLL_TO_ROLL
from vamgpu.optics.film import Film
from vamgpu.optics.roller import Roller
from vamgpu.optics.roller_rays import Traced
from vamgpu.optics.wrap_map import WrapMap
from vamgpu.reports import style
from vamgpu.web import Propagation, WebGrid

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SHOWN = 7.0
"""Drawn length of the straight runs [mm]."""


def roller(
    device: Device,
    quick: bool = False,
    radius: float = 7.5,
    thickness: float = 3.0,
    resin_index: float = 1.49,
    bath_index: float = 1.33,
    absorption: float = 0.22,
    step: float = np.pi / 360.0,
    pixel: float = 0.05,
) -> Picture:
    """The roller of roll-to-roll printing in water; step [rad]."""
    machine = Roller(radius, Film(thickness, resin_index, bath_index, absorption), step)
    plain = replace(machine, film=replace(machine.film, bath_index=resin_index), rays=64)
    web = WebGrid((1, 12 if quick else 40, 1), (machine.advance, thickness / (12 if quick else 40), pixel))
    beam = Beam((int(2 * machine.outer / pixel), 1), pixel)
    light, map = machine.propagation(web, beam), machine.map(web)
    figure, axes = style.sheet("abc;ddd;eef", 9.8, height_ratios=[1.2, 0.72, 1.0])
    _rays(axes["a"], machine)
    drawn = _field(axes["b"], map, absorption)
    _wrapped(axes["c"], map, flat_dose(light, web, beam), absorption)
    style.bar(drawn, [axes["a"], axes["b"], axes["c"]], "absorbed per volume under irradiance 1 [1/mm]",
              location="bottom", shrink=0.4, aspect=40, ticks=absorption * np.linspace(0, 1, 5))  # fmt: skip
    _flat(axes["d"], map, light, web)
    against = _depths(axes["e"], plain, web, beam)
    lost = _loss(axes["f"], machine)
    caption = (
        "Light from below meets a film that a roller carries past. It refracts at the outer face and runs straight to "
        "the roller, or into a straight length of the web, whose faces reflect it totally. The absorbed light is "
        "traced once, at one angle, exactly from wall to wall through voxels that are sectors of a ring. It is then "
        "assigned to the flattened film: a bent voxel and its flat self absorb the same energy. Without refraction the "
        "trace is the paper's closed formula. Near grazing incidence less light enters. The gain of the columns that "
        "compensate for this is clipped at 2, which loses few angles."
    )
    return Picture(figure, caption, (*_facts(machine, map, light, beam), *against, *lost), papers=(ROLL_TO_ROLL,))


def flat_dose(light: Propagation, web: WebGrid, beam: Beam) -> np.ndarray:
    """Power per volume of the flat film under a beam of irradiance 1 [1/mm], (rho, l)."""
    n_rho, n_l = light.shape[1:]
    total = np.bincount(light.rho.astype(np.int64) * n_l + light.l, light.weight, n_rho * n_l)
    return total.reshape(n_rho, n_l) * beam.pitch / (web.edges[0] * web.edges[1])


def _facts(machine: Roller, map: WrapMap, light: Propagation, beam: Beam) -> list[Fact]:
    offsets, _ = machine._bundle(beam.pitch)
    traced = machine.trace(beam.columns()[:, None] + offsets, leg=map.leg)
    lost = np.sum(traced.transmittance * -np.expm1(-machine.film.absorption * traced.length)) / offsets.size
    return [
        Fact("angles covered at the outer face, 2·asin(m)", machine.film.coverage, "rad", expected=2.2,
             source="paper, 1.33 / 1.49, rounded"),
        Fact("depth in which light falls to 5 %", machine.film.penetration, "mm", expected=13.6, source="paper"),
        Fact("quarter of the mid-line's circumference", 0.5 * map.arc, "mm", expected=14.1, source="paper"),
        Fact("travel of the web per angle", 1e3 * machine.advance, "µm", expected=78.5, source="0.5° at 9 mm"),
        Fact("window: curved film and both straight lengths", map.length, "mm"),
        Fact("entries of the propagation", float(light.weight.size), "", 6),
        Fact("share of the light that the film absorbs", float(light.weight.sum() / beam.pixels[0])),
        Fact("energy in the voxels against the rays', relative", abs(float(light.weight.sum() / lost) - 1.0), "", 2,
             expected=1e-4, bound="≤"),
    ]  # fmt: skip


def _body(axis: Axes, machine: Roller) -> None:
    from matplotlib.patches import Circle, Rectangle, Wedge

    r_i, r_o = machine.radius, machine.outer
    axis.add_patch(Wedge((0, 0), r_o, 180, 360, width=r_o - r_i, fc=style.RESIN, ec="none"))
    for left in (-r_o, r_i):
        axis.add_patch(Rectangle((left, 0), r_o - r_i, SHOWN, fc=style.RESIN, ec="none"))
    axis.add_patch(Circle((0, 0), r_i, fc=style.FAINT, ec="none"))


def _framed(axis: Axes, machine_outer: float, title: str) -> None:
    axis.set(xlim=(-1.05 * machine_outer, 1.05 * machine_outer), ylim=(-1.25 * machine_outer, SHOWN), aspect="equal",
             xlabel="x [mm]", title=title)  # fmt: skip
    axis.grid(False)


def _rays(axis: Axes, machine: Roller, count: int = 31) -> None:
    _body(axis, machine)
    axis.text(0, 0, "roller", ha="center", color=style.QUIET)
    u = np.linspace(-0.985, 0.985, count) * machine.outer
    traced: Traced = machine.trace(u)
    s = traced.segments
    for x in u:
        axis.plot([x, x], [-1.25 * machine.outer, -np.sqrt(machine.outer**2 - x**2)], color=style.ORANGE, lw=0.7)
    left = s.power * np.exp(-machine.film.absorption * s.before)
    for i in range(s.ray.size):
        ends = np.array([[s.x[i], s.y[i]], [s.x[i] + s.length[i] * s.dx[i], s.y[i] + s.length[i] * s.dy[i]]])
        axis.plot(ends[:, 0], ends[:, 1], color=style.ORANGE, lw=1.1, alpha=0.25 + 0.75 * float(left[i]))
    _framed(axis, machine.outer, "Rays at one angle")
    axis.set(ylabel="y, along the light [mm]")


def _field(axis: Axes, map: WrapMap, absorption: float) -> Any:
    x, y = np.linspace(-map.outer, map.outer, 421), np.linspace(-map.outer, SHOWN, 301)
    beta = map.path(x[None, :], y[:, None])
    drawn = axis.pcolormesh(x, y, map.absorbed(x[None, :], y[:, None], absorption), cmap=style.LIGHT, vmin=0.0,
                            vmax=absorption, rasterized=True)  # fmt: skip
    lines = axis.contour(x, y, beta, levels=[1, 2, 4, 6, 8, 10], colors="white", linewidths=0.7)
    axis.clabel(lines, levels=[1, 2, 4, 8], fontsize=7, fmt="%g mm")
    _framed(axis, map.outer, "$α_V$, and lines of $β$, unrefracted")
    return drawn


def _wrapped(axis: Axes, map: WrapMap, dose: np.ndarray, absorption: float) -> None:
    n_rho, n_l = dose.shape
    edges_l, edges_rho = np.linspace(0, map.length, n_l + 1), np.linspace(0, map.outer - map.inner, n_rho + 1)
    x, y = map.wrapped(edges_l[None, :], edges_rho[:, None])
    middle = [0.5 * (e[1:] + e[:-1]) for e in (edges_l, edges_rho)]
    bent = dose / map.jacobian(middle[0][None, :], middle[1][:, None])
    axis.pcolormesh(x, y, bent, cmap=style.LIGHT, vmin=0.0, vmax=absorption, rasterized=True)
    _framed(axis, map.outer, "The same, traced with refraction")


def _flat(axis: Axes, map: WrapMap, light: Propagation, web: WebGrid) -> None:
    n_rho, n_l = light.shape[1:]
    few = np.linspace(0.004, 0.996, 15) * (light.shape[0] - 1)
    chosen = np.isin(light.r, np.round(few).astype(int))
    flat = light.rho[chosen].astype(np.int64) * n_l + light.l[chosen]
    shown = np.bincount(flat, light.weight[chosen], n_rho * n_l).reshape(n_rho, n_l)
    extent = (-map.middle, map.middle, 0.0, map.outer - map.inner)
    axis.imshow(np.sqrt(shown / shown.max()), origin="lower", extent=extent, aspect="auto", cmap=style.LIGHT,
                interpolation="nearest")  # fmt: skip
    for side in (-0.5, 0.5):
        axis.axvline(side * map.arc, color="white", lw=0.8, ls=(0, (4, 3)))
    axis.set(
        xlabel="l from the place nearest the light [mm]",
        ylabel="rho [mm]",
        title="Fifteen columns in the flattened film, root of the absorbed power; straight runs begin at broken lines",
    )
    axis.grid(False)


def _depths(axis: Axes, plain: Roller, web: WebGrid, beam: Beam) -> list[Fact]:
    """Unrefracted light in the flat film, compared with α_V times the Jacobian."""
    light, map = plain.propagation(web, beam), plain.map(web)
    dose, alpha = flat_dose(light, web, beam), plain.film.absorption
    n_rho, n_l = dose.shape
    along = ((np.arange(4 * n_l) + 0.5) * 0.25 * web.edges[0])[None, :]
    depth = ((np.arange(4 * n_rho) + 0.5) * 0.25 * web.edges[1])[:, None]
    field = map.absorbed(*map.wrapped(along, depth), alpha) * map.jacobian(along, depth)
    wanted = field.reshape(n_rho, 4, n_l, 4).mean(axis=(1, 3))
    rho = (np.arange(n_rho) + 0.5) * web.edges[1]
    for degrees, hue in zip((15, 45, 75, 90), style.HUES, strict=False):
        at = int((map.middle + np.radians(degrees) * map.neutral) / web.edges[0]) - (degrees == 90)
        near = slice(at - 4, at + 5) if degrees < 90 else slice(at, at + 1)
        axis.plot(rho, wanted[:, near].mean(axis=1), color=hue, label=f"{degrees}°")
        axis.plot(rho[::2], dose[:, near].mean(axis=1)[::2], "o", ms=3.5, color=hue)
    axis.set(xlabel="rho [mm]", ylabel="absorbed per volume [1/mm]", ylim=(0, None),
             title="Without refraction: traced (dots), $α_V$ times the Jacobian (lines)")  # fmt: skip
    axis.legend(title="from the light", ncols=2)
    gap: Any = np.sqrt(np.mean((dose / wanted - 1.0) ** 2))
    return [
        Fact("traced against α_V, voxel by voxel, RMS", 100 * float(gap), "%", 2),
        Fact("their energies, relative", abs(float(dose.sum() / wanted.sum()) - 1.0), "", 2, expected=1e-4, bound="≤"),
    ]


def _loss(axis: Axes, machine: Roller) -> list[Fact]:
    angle = np.linspace(0.0, 0.5 * np.pi, 400, endpoint=False)
    u = machine.outer * np.sin(angle)
    found = machine.coverage()
    axis.plot(np.degrees(angle), machine.transmittance(u), color=style.BLUE, label="transmittance T")
    axis.plot(np.degrees(angle), machine.gain(u), color=style.ORANGE, label="gain, 1/T clipped")
    axis.axvline(np.degrees(found.clipped), color=style.RED, lw=1, ls=(0, (4, 3)))
    axis.set(xlabel="angle of incidence [°]", xlim=(0, 90), ylim=(0, 2.2), title="Fresnel's loss")
    axis.legend(loc="upper left")
    return [
        Fact(
            f"angle of incidence from which a gain of {found.limit:g} is too little",
            float(np.degrees(found.clipped)),
            "°",
        ),  # fmt: skip
        Fact("angles at the outer face that clipping loses", float(np.degrees(found.lost)), "°", 3),
        Fact("angles covered at the roller", found.inner, "rad"),
    ]
