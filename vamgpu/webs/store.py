"""The folder of a web: its frames only grow in number, and a record counts those that are complete."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from vamgpu.errors import BadInput, StorageError
from vamgpu.storage.arrays import Layout, create, undamaged
from vamgpu.storage.atomic import explained, explaining, replacing, settle
from vamgpu.storage.folder import digest
from vamgpu.storage.manifest import plain
from vamgpu.storage.reading import is_file, parse_json, read_text

FORMAT = "vamgpu web"
VERSION = 1
RECORD = "web.json"
PARTIAL = ".partial"
AXES = {"frames": ("pose", "row", "column"), "target": ("l", "rho", "z")}


@dataclass(frozen=True)
class SegmentRecord:
    """A segment in the folder's record: spans, losses, and SHA-256 of frames and target."""

    frames: tuple[int, int]  # first and one after the last
    columns: tuple[int, int]  # first and one after the last
    loss: tuple[float, float]  # of the first and last iteration
    saturated: int  # pixels that needed more light than a full-on mirror gives
    sha256: tuple[str, str]


@dataclass(frozen=True)
class WebFolder:
    """An opened folder of a web: Zarr arrays ``frames`` and ``target``, of which only ``segments`` are complete."""

    path: Path
    details: dict[str, Any]  # information for readers, by subject
    segments: tuple[SegmentRecord, ...] = ()
    complete: bool = False  # whether the web is complete

    @classmethod
    def open(cls, path: str | Path) -> WebFolder:
        """Read the record of a folder. Raises `StorageError` if there is none or it is damaged."""
        file = Path(path) / RECORD
        try:
            data = parse_json(read_text(file))
            if data["format"] != FORMAT or data["version"] != VERSION:
                raise KeyError(f"format {data['format']!r}, version {data['version']!r}")
            segments = tuple(_segment(entry) for entry in data["segments"])
            return cls(Path(path), dict(data["details"]), segments, bool(data["complete"]))
        except FileNotFoundError as error:
            raise StorageError(f"{str(path)!r} is not a web: it has no {RECORD}; check the path") from error
        except OSError as error:
            raise explained("read", file, error) from error
        except (KeyError, TypeError, ValueError) as error:
            raise StorageError(f"{str(file)!r} is not a record of a web: {error}; check the path") from error

    @classmethod
    def create(
        cls, path: str | Path, details: Mapping[str, Any], frame: tuple[int, int], section: tuple[int, int],
        lengths: tuple[int, int],
    ) -> WebFolder:  # fmt: skip
        """Begin a folder; lengths are frames and columns of a segment. Raises `StorageError`."""
        place = Path(path)
        empty = place.is_dir() and not place.is_symlink() and not any(place.iterdir())
        if os.path.lexists(place) and not empty:
            raise StorageError(f"{str(path)!r} exists; choose another path, resume it, or allow overwriting it")
        folder = cls(place, dict(plain(dict(details), "details")))
        with replacing(place, overwrite=empty) as draft:  # a run killed here leaves no folder
            draft.mkdir()
            for name, shape, length in (("frames", frame, lengths[0]), ("target", section, lengths[1])):
                create(draft, name, (0, *shape), np.dtype(np.uint8), (length, *shape), AXES[name])
            replace(folder, path=draft)._save()
        return folder

    @property
    def frames(self) -> int:
        """Number of complete frames."""
        return self.segments[-1].frames[1] if self.segments else 0

    @property
    def columns(self) -> int:
        """Number of complete columns of the target."""
        return self.segments[-1].columns[1] if self.segments else 0

    def append(
        self, frames: np.ndarray, target: np.ndarray, loss: tuple[float, float], saturated: int, complete: bool
    ) -> WebFolder:
        """Add a segment: frames uint8 [pose, row, column], target uint8 [l, rho, z]. Raises `StorageError`."""
        spans = ((self.frames, self.frames + len(frames)), (self.columns, self.columns + len(target)))
        record = SegmentRecord(*spans, loss, saturated, (digest(frames), digest(target)))
        longer = replace(self, segments=(*self.segments, record), complete=complete)
        with explaining("write", self.path):
            _write(self.path, "frames", spans[0], frames)
            _write(self.path, "target", spans[1], target)
            longer._save()
        return longer

    def swept(self) -> WebFolder:
        """The same folder without the uncounted data that an interrupted run left. Raises `StorageError`."""
        with explaining("clean", self.path):
            for name, length in (("frames", self.frames), ("target", self.columns)):
                for file in (self.path / name).rglob(f"*{PARTIAL}"):
                    file.unlink()
                array = _open(self.path, name, "r+")
                if array.shape[0] != length:
                    array.resize((length, *array.shape[1:]))
                kept = -(-length // _per_file(array))
                for file in (self.path / name / "c").glob("*"):
                    if file.name.isdigit() and int(file.name) >= kept:
                        shutil.rmtree(file)
            (self.path / (RECORD + PARTIAL)).unlink(missing_ok=True)
        return self

    def read(self, name: str, start: int, stop: int) -> np.ndarray:
        """Entries of ``frames`` or ``target``. Raises `StorageError` if damaged, `BadInput` beyond the end."""
        end = self.frames if name == "frames" else self.columns
        if not 0 <= start <= stop <= end:
            raise BadInput(f"{name} {start} to {stop}; expected 0 to {end}")
        with undamaged(f"{name} {start} to {stop}", self.path, "web"):
            return Layout.of(self.path / name).entries(range(start, stop))

    def _digest(self, name: str, span: range) -> str:
        """SHA-256 of some entries, read in parts."""
        seal = hashlib.sha256()
        with undamaged(f"{name} {span.start} to {span.stop}", self.path, "web"):
            for part in Layout.of(self.path / name).parts(span, whole=False):
                seal.update(part.view(np.uint8).data)
        return seal.hexdigest()

    def frame(self, pose: int) -> np.ndarray:
        """One frame, uint8 [row, column]."""
        return self.read("frames", pose, pose + 1)[0]

    def verify(self) -> None:
        """Read everything and compare it with its hashes; raises `StorageError` at the first difference."""
        for k, segment in enumerate(self.segments):
            for name, span, expected in zip(AXES, (segment.frames, segment.columns), segment.sha256, strict=True):
                found = self._digest(name, range(*span))
                if found != expected:
                    raise StorageError(
                        f"{name} of segment {k} of {str(self.path)!r} has SHA-256 {found[:12]}…, its record says "
                        f"{expected[:12]}…; the web was changed or damaged, write it again"
                    )

    def files(self) -> Iterator[Path]:
        """Every file that holds frames or target."""
        for name in AXES:
            yield from sorted(file for file in (self.path / name).rglob("*") if is_file(file))

    def _save(self) -> None:
        data = {
            "format": FORMAT,
            "version": VERSION,
            "details": self.details,
            "segments": [asdict(segment) for segment in self.segments],
            "complete": self.complete,
        }
        draft, file = self.path / (RECORD + PARTIAL), self.path / RECORD
        draft.write_text(json.dumps(data, indent=1, ensure_ascii=False), encoding="utf-8")
        settle(draft)
        os.replace(draft, file)
        settle(self.path)


def _segment(entry: Mapping[str, Any]) -> SegmentRecord:
    pairs = {name: tuple(entry[name]) for name in ("frames", "columns", "loss", "sha256")}
    return SegmentRecord(saturated=int(entry["saturated"]), **pairs)  # type: ignore[arg-type]


def _open(place: Path, name: str, mode: Any) -> Any:
    import zarr

    return zarr.open_array(place / name, mode=mode, zarr_format=3, config={"write_empty_chunks": True})


def _per_file(array: Any) -> int:
    return int(array.shards[0])


def _write(place: Path, name: str, span: tuple[int, int], values: np.ndarray) -> None:
    """Lengthen an array by a segment, and write its file to the disk."""
    if span[0] == span[1]:
        return
    array = _open(place, name, "r+")
    array.resize((span[1], *array.shape[1:]))
    array[span[0] : span[1]] = values
    each = _per_file(array)
    for number in range(span[0] // each, -(-span[1] // each)):
        path = place / name / "c" / str(number) / "0" / "0"
        part = values[max(number * each - span[0], 0) : (number + 1) * each - span[0]]
        if not path.exists() and not part.any():
            continue  # a segment of darkness makes no file; the digest shows if a file was lost
        settle(path, path.parent, path.parent.parent, path.parent.parent.parent)
    settle(place / name / "zarr.json", place / name)
