"""A boat that sinks while it is printed, whose frames follow or not, and one that is printed three images tall."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from profiling.gallery.dualcolor import verdict
from profiling.gallery.picture import Fact, Picture, Table
from profiling.gallery.scene import boat, upright
from vamgpu.backend.device import Device
from vamgpu.geometry import Beam, Turntable
from vamgpu.methods import optimize
from vamgpu.methods.papers import LIMITED_MEMORY
from vamgpu.operators.follow import followed
from vamgpu.operators.projection import Projection
from vamgpu.printing.pack import pack
from vamgpu.printing.simulate import simulate
from vamgpu.reports import style
from vamgpu.travel import Travel

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PITCH = 0.1
SPARE = 2
"""Rows of the beam above and below the part."""


def travel(
    device: Device, quick: bool = False, height: float = 3.7, angles: int = 120, iterations: int = 60,
    voxels: float = 4.0, turns: int = 6,
) -> Picture:  # fmt: skip
    """The boat at rest, sinking, and rising past a low image.

    height: of the boat [mm]. voxels: by which it sinks, steadily, in all turns.
    """
    target = boat(device, PITCH, 1.6 if quick else height)
    count, steps = (24, 4) if quick else (int(angles), int(iterations))
    rows = target.grid.shape[2] + 2 * SPARE
    beam = Beam((max(target.grid.shape[:2]) + 6, rows), PITCH)
    sunk = -voxels * PITCH * np.arange(turns * count).reshape(turns, count) / (turns * count)
    image = rows // 6 * 2
    paths = {
        "at rest": None,
        "sinks, not followed": Travel(sunk, follow=False),
        "sinks, followed": Travel(sunk),
        f"rises past {image} of {rows} rows": Travel.helix(count, image // 2 * PITCH, height=rows * PITCH, rows=image,
                                                            pitch=PITCH),
    }  # fmt: skip
    plan: Any = None
    proofs = {}
    for name, path in paths.items():
        A = Projection(target.grid, beam, Turntable(count, travel=path), device=device)
        plan = optimize(A, target, iterations=steps, progress=False) if plan is None else plan
        proofs[name] = simulate(A, pack(A, plan.sinogram), target)
    figure = _drawn(target, proofs, followed(Turntable(count, travel=paths["sinks, followed"]), beam))
    rested = proofs["at rest"].scores
    lines = tuple((name, (p.scores.window, p.claimed.window, p.scores.iou)) for name, p in proofs.items())
    facts = tuple(
        Fact(f"window less than at rest: {name}", rested.window - proof.scores.window, "", 2,
             None if "not" in name else 0.005, "", "≤")
        for name, proof in proofs.items() if name != "at rest"
    )  # fmt: skip
    caption = (
        f"A boat of {target.height:.3g} mm, {' × '.join(map(str, target.grid.shape))} voxels of {PITCH:g} mm, {count} "
        f"angles; patterns for a boat at rest. It sinks by {voxels:g} voxels in {turns} turns. Frames that follow it "
        "are the same, moved by whole rows of pixels; the fraction of a row that is left blurs the dose by less than a "
        f"pixel. On the right, the boat rises through an image of a third of its height, by {image // 2} rows in each "
        "turn; every row is shown in equally many turns. Independent rays expose the frames where they fall. Above: "
        "the dose in the middle of the boat over the greatest. Below: the print at the best threshold; correct in "
        "black, missing in blue, excess in red. Last: rows by which frames are moved, over the turns."
    )
    table = Table(("print", "strict window, proved", "predicted", "IoU"), ("+.4f", "+.4f", ".4f"), lines)
    return Picture(figure, caption, facts, table, (LIMITED_MEMORY,))


def _drawn(target: Any, proofs: dict[str, Any], path: Any) -> Figure:
    figure, axes = style.sheet("abcd;efgh;iiii", 8.6, height_ratios=[1, 1, 0.7])
    part = upright(proofs["at rest"].target.numpy()) >= 0.5
    for above, below, (name, proof) in zip("abcd", "efgh", proofs.items(), strict=True):
        dose = upright(proof.dose.numpy())
        style.shown(axes[above], dose / proof.scores.peak, name, vmin=0.0, vmax=1.0)
        axes[below].imshow(verdict(dose >= proof.scores.threshold, part).transpose(1, 0, 2), origin="lower",
                           interpolation="nearest")  # fmt: skip
        style.bare(axes[below])
        axes[below].grid(False)
    moved = path.whole[..., 1].ravel() - path.whole[0, 0, 1]
    turn = np.arange(moved.size) / path.whole.shape[1]
    axes["i"].plot(turn, -(moved + path.left[..., 1].ravel()), color=style.ORANGE, label="height of the part")
    axes["i"].step(turn, -moved, where="post", color=style.BLUE, label="rows by which frames are moved")
    axes["i"].set(xlabel="turn", ylabel="pixels", title="Frames follow the part that sinks")
    axes["i"].legend(loc="upper right")
    return figure
