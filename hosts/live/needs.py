"""Requirements of a watched print, checked before anything is proved, opened or lit."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from vamgpu.errors import JobError, StorageError
from vamgpu.hosts.rigs.calibrations import MEASURED, in_force
from vamgpu.hosts.rigs.config import RigConfig, RigFile
from vamgpu.hosts.rigs.guarantees import Guarantee
from vamgpu.jobs.web import is_web_folder
from vamgpu.storage.folder import Folder
from vamgpu.storage.turntable import turntable_from

KIND = "live"  # of the camera's calibration
SAME = 0.02  # greatest relative difference of two exposure times that count as the same
STILL = 1.0  # greatest turn of the vial during an image, in angles of the job


def watchable(job: Path, config: RigConfig, speed: float, *, real: bool, measured: bool) -> None:
    """Raise `JobError`, which lists all needs of a watched print at a speed [deg/s], unless each holds."""
    found = tuple(needs(job, config, speed, real=real, measured=measured))
    if not all(need.holds for need in found):
        lines = (f"  {need.about + ':':<13} {'yes' if need.holds else 'no'}, {need.why}"
                 f"{'; ' + need.remedy if need.remedy and not need.holds else ''}" for need in found)  # fmt: skip
        raise JobError("\n".join(["this print cannot be watched; expected yes in every line:", *lines]))


def needs(job: Path, config: RigConfig, speed: float, *, real: bool, measured: bool) -> Iterator[Guarantee]:
    """The needs of a watched print; see `watchable`. Raises `StorageError` for a folder without a job."""
    setup, geometry = config.setup, {} if is_web_folder(job) else _geometry(job)
    yield _of_a_vial(geometry)
    angles = _angles(geometry)
    yield _need("angles", angles >= 2, f"the job has {angles or 'no'} evenly spaced angles over a full turn",
                "solve it with [turntable] angles = N")  # fmt: skip
    machine = setup.rig.machine
    yield _need("machine", machine in ("vial", "any"), f'the rig has machine = "{machine}"', 'expected "vial" in [rig]')
    yield _need("projector", len(setup.display) == 1, f"the rig has {len(setup.display)}", "expected one [display]")
    there = setup.camera is not None or not real
    yield _need("camera", there, f"the rig has {'one' if there else 'none'}",
                'add [[feedback]] with driver = "camera" to its file')  # fmt: skip
    if measured:
        yield _measured(config)
    if setup.camera is not None and angles:
        yield _at_rest(setup, speed, angles)


def _need(about: str, holds: bool, why: str, remedy: str) -> Guarantee:
    return Guarantee(about, "guaranteed" if holds else "not there", why, remedy)


def _geometry(job: Path) -> dict[str, Any]:
    found = Folder.open(job).manifest.inputs.get("geometry")
    return dict(found) if isinstance(found, dict) else {}


def _of_a_vial(geometry: dict[str, Any]) -> Guarantee:
    vessel = geometry.get("vessel")
    kind = vessel.get("kind") if isinstance(vessel, dict) else None
    holds = "kind" not in geometry and kind == "vial" and "travel" not in geometry.get("turntable", {})
    why = f"the job is {'' if holds else 'not '}for a part at rest in a round vial in uniform light"
    remedy = "solve one with [vial], and without scattering, inserts, a second color or [travel]"
    return _need("job", holds, why, remedy)


def _angles(geometry: dict[str, Any]) -> int:
    """Number of evenly spaced angles of a full turn; 0 if they are not."""
    try:
        motion = turntable_from(geometry["turntable"]).along(None)
    except (KeyError, TypeError, ValueError, StorageError):
        return 0
    return motion.angles if motion.is_even else 0


def _measured(config: RigConfig) -> Guarantee:
    """Whether the camera was measured as it is used."""
    camera, found = config.setup.camera, in_force(config).get(KIND)
    run = f"run vam calibrate live --rig {config.source}"
    if found is None:
        return _need("calibration", False, "the camera was not measured", run)
    numbers = found.tables()[MEASURED]
    for name, key, unit in (("exposure", "exposure_s", "s"), ("bits", "bits", "bits")):
        now, then = getattr(camera, name, None), numbers.get(key)
        if now is not None and then is not None and abs(now - then) > SAME * now:
            why = f"{found.name} was measured with {then:g} {unit}, and [[feedback]] has {now:g}"
            return _need("calibration", False, why, run)
    return _need("calibration", True, f"{found.name} measured the camera", run)


def _at_rest(setup: RigFile, speed: float, angles: int) -> Guarantee:
    """Whether the vial hardly turns during an image."""
    assert setup.camera is not None
    exposure, most = setup.camera.exposure, STILL * 360.0 / angles
    turned = speed * exposure
    return _need("images", turned <= most, f"the vial turns by {turned:.3g} deg during an image; expected "
                 f"{most:.3g} deg at most, the step between angles", f"expose at most {1e3 * most / speed:.3g} ms in "
                 f"[[feedback]], or turn at {most / exposure:.3g} deg/s at most")  # fmt: skip
