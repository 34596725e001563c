"""Live printing: a camera measures, parameters and dose are estimated, and the remaining light is replanned."""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType
from typing import Any

from vamgpu.live.camera import CameraPose, MonitoringCamera, SensorNoise
from vamgpu.live.colors import ColorReplanner
from vamgpu.live.estimate import Estimate, Estimator
from vamgpu.live.loop import Decision, LiveLoop
from vamgpu.live.printer import CuringResin, Truth, VirtualPrinter
from vamgpu.live.prior import Prior
from vamgpu.live.record import LiveRecord, LiveSetup
from vamgpu.live.replan import Replanner
from vamgpu.live.tomography import Tomograph
from vamgpu.live.turbidity import Turbidity
from vamgpu.live.webs import WebReplanner
from vamgpu.webs.drift import WebDrift

__all__ = [
    "CameraPose", "ColorReplanner", "CuringResin", "Decision", "Estimate", "Estimator", "LiveLoop", "LiveRecord",
    "LiveSetup", "MonitoringCamera", "Prior", "Replanner", "SensorNoise", "Tomograph", "Truth", "Turbidity",
    "VirtualPrinter", "WebDrift", "WebReplanner",
]  # fmt: skip


class _CallablePackage(ModuleType):
    """The package ``vamgpu.live`` is also the function ``vamgpu.hosts.live.live_print.live``: a call prints."""

    def __call__(self, *args: Any, **options: Any) -> Any:
        return import_module("vamgpu.hosts.live.live_print").live(*args, **options)


sys.modules[__name__].__class__ = _CallablePackage
