"""The state of a print for the page."""

from __future__ import annotations

import io
import threading
import time
from math import isfinite
from typing import Any

import numpy as np

from vamgpu.hosts.records.state import Board, Snapshot

WIDTH = 640  # pixels of an image's longer side on the page
POINTS = 400  # points of the curve
ARRAYS = ("preview", "others", "camera", "scatter", "maps")
ALLOWED: dict[str, tuple[str, ...]] = {"start": ("standby",), "pause": ("printing",), "resume": ("paused", "held")}
"""Button → states in which it works; other buttons work until the print has ended."""
WANTED = {
    "start": "the print has begun", "pause": "only a print with light can pause",
    "resume": "only a paused or held print can continue",
}  # fmt: skip


def described(now: Snapshot) -> dict[str, Any]:
    """A snapshot as plain values, without images; None for numbers that are not finite, which JSON lacks."""
    plain = {name: value for name, value in vars(now).items() if name not in ARRAYS}
    plain |= {name: [vars(each) for each in plain[name]] for name in ("parameters", "checks")}
    return {name: None if isinstance(value, float) and not isfinite(value) else value for name, value in plain.items()}


def told(board: Board, store: ImageStore) -> dict[str, Any]:
    """The snapshot, its age [s], why buttons are disabled, and numbers of its images."""
    now, names = board.now, board.buttons
    return described(now) | {
        "ended": now.state.ended,
        "waits": None if now.deadline is None else max(0.0, now.deadline - time.monotonic()),
        "ago": None if now.polled is None else max(0.0, time.monotonic() - now.polled),
        "buttons": {name: refusal(now, name) for name in names},
        "images": {name: store.number(name, image) for name, image in images(now).items()},
        "readings": len(now.scatter),
    }


def refusal(now: Snapshot, name: str) -> str | None:
    """Reason why a button does not work now; None if it works."""
    if now.state.ended:
        return f"the print is {now.state.value}; start another one"
    if name == "resume" and now.resuming:
        return "it is already continuing: the light comes when frames and motion are ready"
    if name == "resume" and now.interlock_closed is False:
        return "the enclosure is open: close it first"
    states = ALLOWED.get(name)
    return None if states is None or now.state.value in states else f"{WANTED[name]}; this one is {now.state.value}"


def images(now: Snapshot) -> dict[str, np.ndarray]:
    """Images by name: of each projector, of the camera, and of estimates."""
    frames = () if now.preview is None else (now.preview, *now.others)
    named = {f"projector {n + 1}": frame for n, frame in enumerate(frames)}
    return named | ({} if now.camera is None else {"camera": now.camera}) | dict(now.maps)


def curve(now: Snapshot) -> dict[str, Any]:
    """Scatter over time, thinned for a page; the last reading stays."""
    count = len(now.scatter)
    step = max(1, -(-count // POINTS))
    kept = [now.scatter[k] for k in range((count - 1) % step, count, step)] if count else []
    points = [[reading.seconds, reading.density] for reading in kept]
    return {"threshold": now.threshold, "points": points}


class ImageStore:
    """Images for browsers. Each is encoded once for all requests; requests never wait for the print."""

    def __init__(self) -> None:
        self._lock, self._encoding = threading.Lock(), threading.Lock()
        self._seen: dict[str, tuple[np.ndarray, int]] = {}
        self._made: dict[str, tuple[np.ndarray, bytes]] = {}

    def number(self, name: str, image: np.ndarray) -> int:
        """Number of different images of a name; pages load the image when it changes."""
        with self._lock:
            before, count = self._seen.get(name, (None, 0))
            if before is not image:
                self._seen[name] = (image, count := count + 1)
            return count

    def png(self, name: str, image: np.ndarray) -> bytes:
        """An image, thinned to the page's size."""
        with self._encoding:
            made = self._made.get(name)
            if made is None or made[0] is not image:
                made = self._made[name] = (image, _encoded(image))
            return made[1]


def _encoded(image: np.ndarray) -> bytes:
    from PIL import Image

    step = max(1, -(-max(image.shape) // WIDTH))
    thin = np.ascontiguousarray(image[::step, ::step])
    if thin.dtype != np.uint8:  # a camera with more bits
        thin = (thin / max(1, int(thin.max(initial=1))) * 255).astype(np.uint8)
    kept = io.BytesIO()
    Image.fromarray(thin).save(kept, "PNG", compress_level=1)
    return kept.getvalue()
