"""``vam studio``: the page for jobs, proofs and prints."""

from __future__ import annotations

import json
import os
import sys
import threading
import webbrowser
from contextlib import suppress
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter
from rich.markup import escape

from vamgpu.cli.commands import app
from vamgpu.cli.options import Overwrite, Settings, console

WORKSPACE = "vamgpu-studio"  # folder in the home folder that is the workspace unless another one is given
DISPLAYS = ("DISPLAY", "WAYLAND_DISPLAY")
"""Variables of a screen on Linux; without one, a text browser would take over the terminal."""


@app.command
def studio(
    workspace: Path | None = None, /, *, port: int = 0, host: str = "127.0.0.1",
    browser: Annotated[bool, Parameter(negative="--no-browser")] = True,
) -> None:  # fmt: skip
    """Serve the page for jobs, proofs and prints on this machine, and open it; Ctrl-C ends it, but tasks continue.

    Args:
        workspace: a folder, or a job file, mesh or job folder in it; ~/vamgpu-studio by default
        port: port of the page; by default a free one
        host: address that serves the page; it must be one of this machine
        browser: open the page in the browser
    """
    from vamgpu.studio.server import Studio

    place = Path.home() / WORKSPACE if workspace is None else workspace
    if workspace is None:
        place.mkdir(exist_ok=True)
    with Studio(place, host, port) as served:
        console().print(f"page    [bold]{escape(served.url)}[/]\nfolder  {escape(str(served.workspace.folder))}")
        if browser and (sys.platform != "linux" or any(map(os.environ.get, DISPLAYS))):
            webbrowser.open(served.url_once())
        with suppress(KeyboardInterrupt):
            threading.Event().wait()


@app.command
def orient(
    job: Path, /, *, out: Path | None = None, count: int = 20, device: str | None = None, settings: Settings = None,
    overwrite: Overwrite = False,
) -> None:  # fmt: skip
    """Solve a part coarsely in several orientations, and list the five with the widest windows.

    Args:
        job: the TOML file of a vial
        out: JSON file of what was found; the file's name with .orientations.json by default
        count: number of orientations
        device: where to compute; that of the job by default
    """
    from vamgpu.cli.progress import shown
    from vamgpu.jobs.orient import orientations
    from vamgpu.jobs.progress import recorded
    from vamgpu.jobs.read import read_job
    from vamgpu.storage.atomic import check_folder, named, replacing

    place = named(out or job.with_suffix(".orientations.json"))
    check_folder(place)
    checked, screen = read_job(job, settings or ()), console()
    with recorded(place, "orient") as events, shown(screen, events) as progress:
        found = orientations(checked, count, device, progress)
        with replacing(place, overwrite=overwrite) as draft:
            draft.write_text(json.dumps({"best": found}, indent=2) + "\n", encoding="utf-8")
    for one in found:
        screen.print(f"{one['rank']}  tilt {one['tilt']:.0f}°, direction {one['azimuth']:.0f}°  window "
                     f"[bold]{one['window']:+.3f}[/], IoU {one['iou']:.4f}, height {one['height']:.3g} mm")  # fmt: skip
