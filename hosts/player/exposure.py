"""Automatic exposure of a print: a camera watches the resin, and the light goes off when it scatters enough."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass

import numpy as np

from vamgpu.errors import BadInput, DeviceLost, StorageError
from vamgpu.hosts.drivers.camera import CameraDriver
from vamgpu.hosts.records.record import RunFolder
from vamgpu.hosts.records.state import Board
from vamgpu.hosts.schedules.clock import Clock
from vamgpu.hosts.schedules.timing import SECOND, whole
from vamgpu.printing.scatter import ScatterReading, ScatterStop
from vamgpu.storage.atomic import explaining

log: logging.Logger = logging.getLogger(__name__)
PERIOD = SECOND // 10  # least time between two readings [ns]
PATIENCE = 2 * SECOND  # greatest age of the camera's last image [ns]
SATURATED = 1e-3  # share of saturated pixels above which an image is overexposed
IDLE = 1e-3  # pause of the thread after an unread image [s], for cameras that do not wait
LEAVE = 1.0  # longest time for the thread to end [s]


@dataclass(frozen=True)
class StopRule:
    threshold: float  # scatter density [gray levels/voxel]
    voxels: float  # voxels of the part
    bits: int = 8  # greatest level of the camera
    exposure: float = 0.01  # exposure time of an image [s]
    discard: int = 0  # images that the camera may have taken before the request


class ScatterWatch(AbstractContextManager["ScatterWatch"]):
    """Watches a print from before its light to its end; a context manager. Writes ``scatter.csv``: seconds, density."""

    def __init__(
        self, camera: CameraDriver, clock: Clock, wanted: StopRule, folder: RunFolder, lit: Callable[[], float], *,
        patience: int = PATIENCE, board: Board | None = None,
    ) -> None:  # fmt: skip
        self.rule: ScatterStop = ScatterStop(wanted.voxels, wanted.threshold)
        self._board = board or Board()
        self._board.show(scatter=self.rule.readings, threshold=wanted.threshold)
        self._camera, self._clock, self._wanted, self._folder, self._lit = camera, clock, wanted, folder, lit
        self._patience = whole("patience [ns]", patience) + round(wanted.exposure * SECOND)
        self._background: tuple[int, np.ndarray] | None = None
        self._origin: int | None = None
        self._last = self._due = clock.now()
        self._said: str | None = None
        self._saturated: float | None = None
        self._failed: BaseException | None = None
        self._seen, self._leave = threading.Event(), threading.Event()
        # on a simulated clock, images are taken when due
        self._thread = threading.Thread(target=self._run, name="camera", daemon=True) if clock.real else None
        with explaining("write", folder.path / "scatter.csv"):
            self._file = (folder.path / "scatter.csv").open("w", buffering=1, encoding="utf-8")
            self._file.write("seconds,density\n")

    def begin(self) -> None:
        """Take the background, in the dark. Raises `DeviceLost`, and `BadInput` if it is overexposed."""
        self._camera.expose(1e6 * self._wanted.exposure)
        self._last = self._due = self._clock.now()
        if self._thread is None:
            self._discard()
            self._take(self._camera.grab())
        else:
            self._thread.start()
            self._seen.wait((1 + self._wanted.discard) * self._patience / SECOND)
        self._check()

    def __exit__(self, *_: object) -> None:
        """End the thread; a camera that hangs is left behind."""
        self._leave.set()
        if self._thread is not None and self._thread.is_alive():
            self._thread.join(LEAVE)
            if self._thread.is_alive():
                log.warning("the camera still holds its thread after %g s", LEAVE)
        try:
            self._file.close()
        except OSError as error:  # a full disk was reported before
            log.warning("'scatter.csv' of %r is cut short: %s", str(self._folder.path), error)

    def _over(self, image: np.ndarray) -> float:
        """Share of saturated pixels."""
        return float((image >= 2**self._wanted.bits - 1).mean())

    def _check(self) -> None:
        self._alive()
        if self._background is None:
            raise DeviceLost("the camera gave no image before the light; check its cable and its exposure")
        image = self._background[1]
        if (over := self._over(image)) > SATURATED:
            raise BadInput(
                f"{100 * over:.1f} % of the camera's pixels are saturated before the light; expected "
                f"{100 * SATURATED:g} % at most: lower exposure in [[feedback]], or dim the camera's light"
            )
        self._folder.event("background", self._background[0], levels=float(image.sum(dtype=np.float64)))

    def recover(self) -> None:
        """Watch again with a failed camera, before a print continues."""
        self._last = self._due = self._clock.now()
        if self._failed is not None and self._thread is not None and not self._thread.is_alive():
            self._failed = None
            self._thread = threading.Thread(target=self._run, name="camera", daemon=True)
            self._thread.start()

    def enough(self) -> str | None:
        """Why the part has enough light; None before. Raises the error of the camera or the disk."""
        if self._origin is None and (lit := self._lit()) >= 0:
            self._open(self._clock.now() - round(lit * SECOND))
        if self._thread is None and self._origin is not None and self._clock.now() >= self._due:
            self._take(self._camera.grab())
        self._alive()
        return self._said

    def short(self) -> str:
        """Message for a print that ended without the stop."""
        most = max((reading.density for reading in self.rule.readings), default=0.0)
        said = (
            f"scatter density reached {most:.3g} of {self._wanted.threshold:g} in all its turns: the part may lack "
            "light; allow more turns, or a lower density"
        )
        if self._saturated is not None:
            said += f". The camera was overexposed from {self._saturated:.1f} s on: lower exposure in [[feedback]]"
        log.warning("%s", said)
        return said

    def _alive(self) -> None:
        if self._failed is not None:
            raise self._failed
        age = self._clock.now() - self._last
        if self._thread is not None and age > self._patience:
            raise DeviceLost(f"the camera gave no image for {age / SECOND:.2g} s; check its cable and its exposure")

    def _run(self) -> None:
        """Take all images of the camera, so that none is old, and evaluate some."""
        try:
            self._discard()
            while not self._leave.is_set():
                self._take(self._camera.grab())
                self._leave.wait(IDLE)
        except BaseException as error:  # set by the printing thread, in the dark
            self._failed = error
            self._seen.set()

    def _discard(self) -> None:
        for _ in range(self._wanted.discard):
            self._camera.grab()

    def _take(self, image: np.ndarray) -> None:
        now = self._clock.now()
        self._last = now
        if self._background is None:
            self._background = (now, image)
            self._seen.set()
        elif self._origin is not None and now >= self._due and self._said is None:
            self._due += PERIOD * (1 + (now - self._due) // PERIOD)
            seconds = (now - self._origin) / SECOND
            if self._saturated is None and (over := self._over(image)) > SATURATED:
                self._saturated = seconds
                self._folder.event("overexposed", now, seconds=seconds, share=over)
            self._board.show(camera=image)
            self._keep(self.rule.see(seconds, image))

    def _open(self, origin: int) -> None:
        """Set the time of the first light in an image, from which seconds count."""
        assert self._background is not None
        when, image = self._background
        self._keep(self.rule.see((min(when, origin) - origin) / SECOND, image))
        self._due += PERIOD * max(0, -((self._due - self._clock.now()) // PERIOD))
        self._origin = origin

    def _keep(self, reading: ScatterReading) -> None:
        try:
            self._file.write(f"{reading.seconds:.6f},{reading.density:.9g}\n")
        except OSError as error:
            raise StorageError(f"'scatter.csv' of {str(self._folder.path)!r} cannot be written: {error}") from error
        if reading.stop:
            facts = {"seconds": reading.seconds, "density": reading.density, "crossing": self.rule.crossing}
            self._folder.event("enough", self._clock.now(), threshold=self._wanted.threshold, **facts)
            wanted = f"{self._wanted.threshold:g} after {reading.seconds:.1f} s"
            self._said = f"scatter density {reading.density:.3g} reached {wanted}"
