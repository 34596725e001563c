"""Priority of a process with deadlines: scheduled before others, with locked memory; denied requests are reported."""

from __future__ import annotations

import ctypes
import gc
import os
import sys

HIGH = 0x00000080  # Windows' HIGH_PRIORITY_CLASS
NICE = -10
LEVEL = 10  # level in the real-time class, of 1 to 99
LOCKED = 1 | 2 | 4  # mlockall: present memory, future memory, on first use


def raised() -> dict[str, str]:
    """Request everything; returns what was granted, for the record of a run. Call before any thread starts."""
    gc.collect()
    gc.freeze()  # imported objects are never collected
    return {"schedule": _scheduled(), "memory": _locked(), "garbage": "not collected while the light is on"}


def _scheduled() -> str:
    """The class or priority of this process."""
    if sys.platform == "win32":
        kernel = ctypes.windll.kernel32
        kernel.GetCurrentProcess.restype = ctypes.c_void_p
        granted = kernel.SetPriorityClass(ctypes.c_void_p(kernel.GetCurrentProcess()), HIGH)
        return "high priority" if granted else "as other programs; ask an administrator to allow high priority"
    if hasattr(os, "sched_setscheduler"):
        try:
            os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(LEVEL))
            return f"real-time, round robin {LEVEL}"
        except OSError:
            pass
    try:
        os.setpriority(os.PRIO_PROCESS, 0, NICE)
        return f"nice {NICE}"
    except OSError:
        return (
            f"as other programs; allow more in /etc/security/limits.conf: rtprio {LEVEL}, or nice {NICE}, for the user"
        )


def _locked() -> str:
    """Whether the memory of this process is locked."""
    if not sys.platform.startswith("linux"):
        return "as the system pages"
    import resource

    # with a partial limit, later allocations would fail
    unlimited = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0] == resource.RLIM_INFINITY
    if unlimited and not ctypes.CDLL(None, use_errno=True).mlockall(LOCKED):
        return "locked"
    return "as the system pages; allow more in /etc/security/limits.conf: memlock unlimited for the user"
