"""The interface of Vialux's ALP-4 library: numbers, structures, and calls that raise; its ``long`` has 32 bits."""

from __future__ import annotations

import ctypes
import sys
from ctypes import POINTER, Structure, byref, c_int32, c_uint8, c_uint32, c_void_p
from pathlib import Path
from typing import Any

from vamgpu.errors import DeviceBusy, DeviceLost, DeviceNotFound, DeviceRefused, OutOfMemory, VamError

DEFAULT = 0
DEVICE_NUMBER, AVAILABLE_MEMORY, TRIGGER_EDGE, TRIGGER_TIME_OUT = 2000, 2003, 2005, 2014
EDGE_FALLING, EDGE_RISING, TIME_OUT_DISABLE, GATE_BEFORE_FIRST = 2008, 2009, 1, 2022
DISPLAY_HEIGHT, DISPLAY_WIDTH, DMD_MODE, DMD_FLOAT = 2057, 2058, 2064, 1
LAST_FRAME, BINARY_MODE, BINARY_UNINTERRUPTED, DATA_FORMAT, DATA_BINARY_TOPDOWN = 2102, 2104, 2106, 2110, 2
MIN_PICTURE_TIME, MAX_PICTURE_TIME, ON_TIME = 2211, 2213, 2214
PROJECTION_MODE, MASTER, SLAVE = 2300, 2301, 2302
QUEUE_MODE, QUEUE_SEQUENCES, QUEUE_AVAILABLE, PROGRESS, FLAG_QUEUE_IDLE = 2314, 1, 2317, 2318, 1

NOT_ONLINE, NOT_IDLE, NOT_AVAILABLE, NOT_READY, INVALID, BAD_ADDRESS, MEMORY_FULL = range(1001, 1008)
IN_USE, HALTED, INIT_FAILED, COMMUNICATION, REMOVED, NOT_CONFIGURED = range(1008, 1014)
REASONS = {
    NOT_ONLINE: "no such device, or it is not ready: check power, plug and driver",
    NOT_IDLE: "the device is showing frames: halt it first",
    NOT_AVAILABLE: "the number of the device is not valid",
    NOT_READY: "another program has the device: close it",
    INVALID: "a value is outside the range of the device",
    BAD_ADDRESS: "the library could not read the data",
    MEMORY_FULL: "the device's memory is full",
    IN_USE: "the sequence is being shown or is waiting",
    HALTED: "the device was halted during the transfer",
    INIT_FAILED: "the device did not start: switch it off and on",
    COMMUNICATION: "the transfer failed: check the cable",
    REMOVED: "the device was unplugged",
    NOT_CONFIGURED: "the device has no configuration loaded: switch it off and on",
    1014: "the installed driver is too old for this",
    1018: "the mirrors did not wake: check the power supply",
    1019: "the installed driver is too old for this device: update it",
    1020: "the device's memory did not start: switch it off and on",
}
KINDS: dict[int, type[VamError]] = {
    NOT_ONLINE: DeviceNotFound, NOT_AVAILABLE: DeviceNotFound, NOT_READY: DeviceBusy, REMOVED: DeviceLost,
    COMMUNICATION: DeviceLost, MEMORY_FULL: OutOfMemory,
}  # fmt: skip


class Progress(Structure):
    """Progress of the queue: nine numbers of 32 bits."""

    _fields_ = [
        (name, c_uint32)
        for name in ("queue_id", "sequence", "waiting", "iterations_left", "iterations_underflow", "frames_left",
                     "picture_us", "frames_per_iteration", "flags")
    ]  # fmt: skip


class SynchGate(Structure):
    """A gated synch output: frames per period (0: not driven), active level, and the frames with a pulse."""

    _pack_ = 1
    _fields_ = [("period", c_uint8), ("high", c_uint8), ("frames", c_uint8 * 16)]


_LONG, _ID = c_int32, c_uint32
SIGNATURES: dict[str, tuple[Any, ...]] = {
    "AlpDevAlloc": (_LONG, _LONG, POINTER(_ID)),
    "AlpDevInquire": (_ID, _LONG, POINTER(_LONG)),
    "AlpDevControl": (_ID, _LONG, _LONG),
    "AlpDevControlEx": (_ID, _LONG, c_void_p),
    "AlpDevHalt": (_ID,),
    "AlpDevFree": (_ID,),
    "AlpSeqAlloc": (_ID, _LONG, _LONG, POINTER(_ID)),
    "AlpSeqFree": (_ID, _ID),
    "AlpSeqControl": (_ID, _ID, _LONG, _LONG),
    "AlpSeqTiming": (_ID, _ID, _LONG, _LONG, _LONG, _LONG, _LONG),
    "AlpSeqInquire": (_ID, _ID, _LONG, POINTER(_LONG)),
    "AlpSeqPut": (_ID, _ID, _LONG, _LONG, c_void_p),
    "AlpProjStart": (_ID, _ID),
    "AlpProjStartCont": (_ID, _ID),
    "AlpProjHalt": (_ID,),
    "AlpProjControl": (_ID, _LONG, _LONG),
    "AlpProjInquire": (_ID, _LONG, POINTER(_LONG)),
    "AlpProjInquireEx": (_ID, _LONG, c_void_p),
}


def load(path: str | Path) -> Any:
    """The maker's library at a path, or found by the system; DeviceNotFound if there is none."""
    try:
        if sys.platform == "win32":
            return ctypes.WinDLL(str(path))
        return ctypes.CDLL(str(path))
    except OSError as error:
        raise DeviceNotFound(
            f"the ALP library is not at {path} ({error}); install the maker's package and give the library's path"
        ) from error


class Alp:
    """The library's functions, by name, with their types; each raises when it does not return 0."""

    def __init__(self, library: Any) -> None:
        self._functions = {}
        for name, types in SIGNATURES.items():
            try:
                function = getattr(library, name)
            except AttributeError as error:
                raise DeviceNotFound(f"the ALP library has no {name}; it is too old or another library") from error
            function.argtypes, function.restype = types, c_int32
            self._functions[name] = function

    def call(self, name: str, *arguments: Any) -> None:
        """Call a function; DeviceRefused (``code`` is the library's number) or a related error on failure."""
        result = int(self._functions[name](*arguments))
        if result == 0:
            return
        text = f"{name} failed ({result}): {REASONS.get(result, 'an unknown reason; see the maker’s manual')}"
        if kind := KINDS.get(result):
            raise kind(text)
        raise DeviceRefused(text, str(result))

    def number(self, name: str, *arguments: Any) -> int:
        """Call a function whose last argument receives the answer, and return the answer."""
        kind = c_uint32 if name.endswith("Alloc") else c_int32
        answer = kind(0)
        self.call(name, *arguments, byref(answer))
        return answer.value
