"""Images of the resin during the print, each with its angle; the print does not wait for them."""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np

from vamgpu.hosts.drivers.camera import Buffered, CameraDriver
from vamgpu.hosts.schedules.clock import Clock
from vamgpu.hosts.schedules.timing import SECOND

log: logging.Logger = logging.getLogger(__name__)
KEPT = 64  # most images queued for the printing thread; the oldest are dropped
PATIENCE = 2 * SECOND  # greatest age of the last image [ns]
IDLE = 1e-3  # pause of the thread between images [s], for cameras that do not wait
LEAVE = 1.0  # longest time for the thread to end [s]


class LiveCamera:
    """Takes images from the first light on; a context manager. speed: [deg/s].  exposure: [s]."""

    def __init__(
        self, camera: CameraDriver, clock: Clock, lit: Callable[[], bool], speed: float, exposure: float = 0.01
    ) -> None:
        self._camera, self._clock, self._lit, self._speed = camera, clock, lit, speed
        self._exposure = round(exposure * SECOND)
        self._images: deque[dict[str, Any]] = deque(maxlen=KEPT)
        self._notices: deque[tuple[str, dict[str, Any]]] = deque()
        self._before: np.ndarray | None = None
        self._looked: tuple[int, float] = clock.now(), 0.0
        self._last = clock.now()
        self._repeated = self._gone = self._silent = False
        self._leave = threading.Event()
        self._thread = threading.Thread(target=self._run, name="live camera", daemon=True) if clock.real else None

    def __enter__(self) -> LiveCamera:
        try:
            self._camera.expose(self._exposure / 1000)
        except Exception as error:
            self._lost(error)
        self._last = self._clock.now()
        if self._thread is not None and not self._gone:
            self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._leave.set()
        if self._thread is not None and self._thread.is_alive():
            self._thread.join(LEAVE)

    def taken(self, position: float) -> list[dict[str, Any]]:
        """Images since the last call: ``image``, ``angle`` [deg], ``at`` [ns]. position: angle of the vial [deg]."""
        self._looked = self._clock.now(), position
        if self._thread is None and not self._gone:
            self._grab()
        age = self._clock.now() - self._last
        if not self._gone and not self._silent and age > PATIENCE + self._exposure:
            self._silent = True
            self._tell("live camera silent", f"the camera gave no image for {age / SECOND:.2g} s")
        return [self._images.popleft() for _ in range(len(self._images))]

    def notices(self) -> list[tuple[str, dict[str, Any]]]:
        """Events since the last call."""
        return [self._notices.popleft() for _ in range(len(self._notices))]

    def _run(self) -> None:
        while not self._leave.is_set() and not self._gone:
            self._grab()
            self._leave.wait(IDLE)

    def _grab(self) -> None:
        """Take an image; one that equals the last bit for bit is a repeat, because noise always differs."""
        try:
            image = self._camera.grab()
        except Exception as error:
            self._lost(error)
            return
        self._last, (looked, position) = self._clock.now(), self._looked
        self._silent = False
        if self._before is not None and np.array_equal(image, self._before):
            if not self._repeated:
                self._repeated = True
                self._tell("live images repeated", "the camera repeats its last image; repeated ones are not used")
                try:
                    if isinstance(self._camera, Buffered):  # start it again
                        self._camera.flush()
                except Exception as error:
                    self._lost(error)
            return
        self._before, self._repeated = image, False
        middle = self._last - self._exposure // 2
        angle = position + self._speed * (middle - looked) / SECOND
        if angle >= 0 and self._lit():  # else it is not of this print
            self._images.append({"image": image, "angle": angle, "at": middle})

    def _lost(self, error: Exception) -> None:
        self._gone = True
        self._tell("live camera lost", f"the camera is lost: {error}; turns continue without its images")

    def _tell(self, kind: str, why: str) -> None:
        log.warning("%s", why)
        self._notices.append((kind, {"why": why}))
