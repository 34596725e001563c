"""A job's target, dose and frames as layers of napari."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from vamgpu.cli.commands import app
from vamgpu.cli.options import console, solved_folder
from vamgpu.errors import BadInput

if TYPE_CHECKING:
    from vamgpu.printing.proof import Proof


@app.command
def view(job: Path, /, *, device: str | None = None) -> None:
    """Show a job's target, dose, print and frames in napari, if it is installed.

    Args:
        job: the job folder
        device: where to compute the dose; the best device here by default
    """
    from vamgpu.cli.progress import shown
    from vamgpu.jobs.run import prove
    from vamgpu.jobs.web import is_web_folder

    job = solved_folder(job, "view")
    napari = opened()
    if is_web_folder(job):
        raise BadInput(f"{str(job)!r} is an endless web, which cannot be viewed; write its report: vam prove {job}")
    with shown(console()) as progress:
        proof = prove(job, device, progress=progress).proof
    viewer = napari.Viewer(title=proof.name)
    for layer in layers(proof):
        viewer.add_image(**layer)
    napari.run()


def opened() -> Any:
    """The napari package. Raises `BadInput`."""
    try:
        import napari  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise BadInput(
            f'vam view needs napari, which does not load ({error}): pip install "vamgpu[view]"; without it, '
            "vam prove writes a report for a browser"
        ) from error
    return napari


def layers(proof: Proof) -> list[dict[str, Any]]:
    """Layers for napari: volumes as [z, y, x] in mm about the axis, because its slider moves along the first axis."""
    pitch = proof.operator.grid.pitch
    corner = [-0.5 * (n - 1) * pitch for n in proof.dose.shape[::-1]]
    space = {"scale": [pitch] * 3, "translate": corner, "units": ["mm"] * 3, "axis_labels": ["z", "y", "x"]}
    dose, target = (values.numpy().transpose(2, 1, 0) for values in (proof.dose, proof.target))
    return [
        {"data": proof.frames.gray_levels(), "name": "frames", "visible": False,
         "axis_labels": ["angle", "row", "column"]},
        {"data": dose, "name": "dose", "colormap": "inferno", **space},
        {"data": target, "name": "target", "colormap": "gray", "opacity": 0.4, "visible": False, **space},
        {"data": (dose >= proof.scores.threshold).astype("uint8"), "name": "printed", "colormap": "green",
         "opacity": 0.4, "visible": False, **space},
    ]  # fmt: skip
