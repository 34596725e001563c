"""A small tube in a vial, its plan, and prints of it that a camera watches."""

from __future__ import annotations

from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np

from vamgpu.backend import open_device
from vamgpu.backend.device import Device
from vamgpu.live import SensorNoise, Turbidity
from vamgpu.live.printer import CuringResin, Truth, VirtualPrinter
from vamgpu.live.record import LiveSetup
from vamgpu.methods.run import optimize
from vamgpu.metrics import score
from vamgpu.optics.vial import Vial
from vamgpu.printing.frames import Frames
from vamgpu.printing.gray import GrayCurve
from vamgpu.printing.pack import pack

PLANNED = 10


@cache
def setup(method: Any = "lbfgs", iterations: int = 20) -> tuple[LiveSetup, np.ndarray, np.ndarray]:
    vial, red = (Vial(8.0, 0.5, 1.5, 1.5, 1.0, absorption=a) for a in (0.1, 0.0))
    made = LiveSetup(
        (24, 24, 12), 0.2, (48, 12), 0.2, 40, vial, red, 800.0, SensorNoise(0.8, 0.01, 10), CuringResin(),
        Turbidity((0.0, 1.0), (0.0, 0.25)), 1.3, PLANNED, 2 * PLANNED, evaluations=6.0,
    )  # fmt: skip
    plan = made.projection(vial)
    x, y, z = np.meshgrid(*plan.grid.axes(), indexing="ij")
    r = np.hypot(x, y)
    part = ((r < 1.8) & (r > 0.7) & (np.abs(z) < 0.85)).astype(np.float32)
    light = (np.asarray(optimize(plan, part, method, iterations).sinogram) / PLANNED).astype(np.float32)
    return made, part, light


def printer(truth: Truth) -> VirtualPrinter:
    made, _, _ = setup()
    return VirtualPrinter(made.projection(made.vial), made.camera(), made.resin, made.turbidity, truth)


def overlap(printed: np.ndarray) -> float:
    made, part, _ = setup()
    device = made.projection(made.vial).device
    return float(score(device.upload(printed.astype(np.float32)), device.upload(part), threshold=made.resin.gel).iou)


def some_frames(device: Device | str, bits: int = 8) -> Frames:
    """Packed frames of random patterns, with a curve, a flat field and a shift."""
    there = open_device(device)
    plan: Any = SimpleNamespace(sinogram=there.upload(np.random.default_rng(0).random((12, 13, 21))), operator=None)
    flat = np.linspace(0.7, 1.0, 21 * 13).reshape(21, 13)
    curve = GrayCurve.gamma(2.2, black=0.01)
    return pack(plan, bits=bits, gray=curve, flat_field=flat, flip_r=True, shift=(0.5, -1.25))
