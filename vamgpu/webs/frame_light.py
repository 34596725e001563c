"""The light of a web's frames, computed only from their bytes."""

from __future__ import annotations

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.kernels.dwell import weigh_poses
from vamgpu.printing.frames import Frames
from vamgpu.printing.gray import GrayCurve
from vamgpu.storage.reading import malformed
from vamgpu.webs.store import WebFolder


def light_of(folder: WebFolder, first: int, poses: int, gain: np.ndarray, device: Device) -> DeviceArray:
    """Light [angle, r, z] of a folder's frames from ``first`` on, times each frame's gain; 0 without frames."""
    with malformed(f"{str(folder.path)!r} has malformed details", "write the web again"):
        details = folder.details
        columns, rows = (int(n) for n in details["beam"]["pixels"])
        gray, scale = GrayCurve.parse(details["frames"]["gray"]), float(details["frames"]["scale"])
    low, high = max(first, 0), max(min(first + poses, folder.frames), 0)
    images, times = np.zeros((poses, rows, columns), np.uint8), np.zeros(poses, np.float32)
    if low < high:
        images[low - first : high - first] = folder.read("frames", low, high)
        times[low - first : high - first] = gain[low:high]
    light = Frames.from_bytes(images, device, bits=8, gray=gray, scale=scale, columns=columns).irradiance()
    device.launch(weigh_poses, light=light, times=device.table(times), weighted=light)
    return light
