"""One job with several values of its keys: a folder and a proof for each value, on one machine or on a cluster."""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import Path

from vamgpu.errors import BadInput, StorageError, VamError
from vamgpu.jobs.cluster import workers
from vamgpu.jobs.read import read_job
from vamgpu.jobs.run import is_interrupted, prove, solve
from vamgpu.storage.atomic import replacing
from vamgpu.storage.folder import Folder

MOST = 100_000  # largest number of points of a sweep; more are a mistake


@dataclass(frozen=True)
class Point:
    """One combination of values, and its results."""

    number: int  # number of the point, from 1
    values: Mapping[str, str] = field(hash=False)  # key of the job → its value, as for ``--set``
    folder: Path  # the job folder
    window: float = float("nan")  # proved strict process window, relative to the greatest dose; NaN if there is none
    iou: float = float("nan")  # proved intersection over union at the best threshold [0 to 1]
    error_rate: float = float("nan")  # share of voxels on the wrong side of that threshold
    seconds: float = float("nan")  # exposure predicted by the proof [s]; NaN if the job has no irradiance
    error: str = ""  # reason why the point failed; "" if it did not


def values_of(text: str) -> tuple[str, list[str]]:
    """Read a key and its values. Raises `BadInput`."""
    key, equals, rest = text.partition("=")
    values = [value.strip() for value in re.findall(r'(?:"[^"]*"|\[[^\]]*\]|[^,"\[])+', rest)]
    if not key.strip() or not equals or not values or not all(values) or rest.rstrip().endswith(","):
        raise BadInput(f'got {text!r}; expected a key and its values, such as vial.absorption="0.04 /mm","0.05 /mm"')
    return key.strip(), values


def sweep(
    job: str | Path,
    vary: Mapping[str, Sequence[object]],
    path: str | Path,
    *,
    settings: Sequence[str] = (),
    cluster: str | None = None,
    progress: Callable[[Point, int], None] = lambda point, count: None,
) -> list[Point]:
    """Solve and prove a job for every combination of values; returns the points in the order of the combinations.

    A point whose folder exists from an earlier run is only proved. ``sweep.csv`` is rewritten after every point. job:
    seen by the workers of a cluster under the same path, as ``path``, the folder of 0001.vam and so on. vary: key of
    the job → its values. settings: ``key=value`` for all points. cluster: as of `vamgpu.jobs.cluster.workers`.
    progress: called with every finished point and their number. Raises `JobError`, `BadInput` without a key that varies
    or with too many points, `DeviceError`, `StorageError`; the error of a point is in its ``error``.
    """
    source, place = Path(job).resolve(), Path(path).resolve()
    combinations = list(product(*vary.values())) if vary else []
    if not 1 <= len(combinations) <= MOST:
        raise BadInput(f"got {len(combinations)} combinations; expected 1 to {MOST}: name keys and values to vary")
    checked = read_job(source, settings)
    try:
        place.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StorageError(f"cannot make the folder {str(path)!r}: {error}") from error
    points = [
        Point(number, dict(zip(vary, map(str, values), strict=True)), place / f"{number:04}.vam")
        for number, values in enumerate(combinations, 1)
    ]
    tasks = [(source, tuple(settings), point) for point in points]
    with workers(cluster, checked.file.solve.device) as each:
        for found in each(_solved, tasks):
            points[found.number - 1] = found
            _write(place / "sweep.csv", points)
            progress(found, len(points))
    return points


def _solved(task: tuple[Path, tuple[str, ...], Point]) -> Point:
    """Solve and prove one point of a job with settings; its error is returned."""
    source, settings, point = task
    try:
        job = read_job(source, (*settings, *(f"{key}={value}" for key, value in point.values.items())))
        if not _is_done(point.folder, job.given):
            solve(job, point.folder, overwrite=point.folder.exists())
        proof = prove(point.folder, job.file.solve.device).proof
    except VamError as error:
        return replace(point, error=str(error))
    scores, seconds = proof.scores, float("nan") if proof.seconds is None else proof.seconds
    return replace(point, window=scores.window, iou=scores.iou, error_rate=scores.error_rate, seconds=seconds)


def _is_done(folder: Path, given: object) -> bool:
    try:
        return Folder.open(folder).manifest.inputs.get("job") == given and not is_interrupted(folder)
    except StorageError:
        return False


def _write(path: Path, points: Sequence[Point]) -> None:
    with replacing(path, overwrite=True) as part, open(part, "w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow((*points[0].values, "folder", "window", "iou", "error_rate", "seconds", "error"))
        for one in points:
            numbers = (one.window, one.iou, one.error_rate, one.seconds)
            table.writerow((*one.values.values(), one.folder.name, *map(repr, numbers), one.error))
