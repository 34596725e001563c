"""What is known and decided while a print turns: what a camera sees, what the light did, and the light that remains."""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType
from typing import Any

from vamgpu.live.camera import CameraPose, MonitoringCamera, SensorNoise
from vamgpu.live.colors import ColorReplanner, ReplannedColors
from vamgpu.live.estimate import Estimate, Estimator, Prior
from vamgpu.live.loop import Decision, LiveLoop, LiveState
from vamgpu.live.printer import CuringResin, Truth, VirtualPrinter
from vamgpu.live.record import LiveRecord, LiveSetup
from vamgpu.live.replan import Outlook, Replanned, Replanner
from vamgpu.live.tomography import Seen, Tomograph
from vamgpu.live.turbidity import Turbidity
from vamgpu.live.webs import WebReplanner
from vamgpu.webs.drift import WebDrift

__all__ = [
    "CameraPose", "ColorReplanner", "CuringResin", "Decision", "Estimate", "Estimator", "LiveLoop", "LiveRecord",
    "LiveSetup", "LiveState", "MonitoringCamera", "Outlook", "Prior", "Replanned", "ReplannedColors", "Replanner",
    "Seen", "SensorNoise", "Tomograph", "Truth", "Turbidity", "VirtualPrinter", "WebDrift", "WebReplanner",
]  # fmt: skip


class _Room(ModuleType):
    """This room, which prints when it is called: ``vamgpu.live(job, rig)``."""

    def __call__(self, *args: Any, **options: Any) -> Any:
        return import_module("vamgpu.hosts.live.watched").live(*args, **options)


sys.modules[__name__].__class__ = _Room
