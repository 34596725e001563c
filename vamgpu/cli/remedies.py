"""Packages to install for a device, by operating system."""

from __future__ import annotations

import platform
import sys

INTEL = 'pip install "vamgpu[cpu]"'
PROCESSOR = {
    "debian": "apt install pocl-opencl-icd",
    "fedora": "dnf install pocl",
    "arch": "pacman -S pocl",
    "suse": "zypper install pocl",
    "macos": "OpenCL is a part of macOS: update it, or conda install pocl",
    "windows": "install Intel's CPU Runtime for OpenCL Applications",
    "linux": "install PoCL with the system's package manager",
}
"""System → how to install an OpenCL device on its processor."""
GRAPHICS = {
    "debian": "apt install nvidia-opencl-icd, intel-opencl-icd or mesa-opencl-icd, depending on the card",
    "fedora": "dnf install intel-compute-runtime or mesa-libOpenCL, or xorg-x11-drv-nvidia-cuda from RPM Fusion",
    "arch": "pacman -S opencl-nvidia, intel-compute-runtime or opencl-mesa, depending on the card",
    "suse": "install the card's driver with its OpenCL part",
    "macos": "OpenCL is a part of macOS: update it",
    "windows": "install the card's driver from its maker; OpenCL is a part of it",
    "linux": "install the card's driver with its OpenCL part",
}
"""System → how to install an OpenCL device on a graphics card."""
FAMILIES = {"ubuntu": "debian", "rhel": "fedora", "centos": "fedora", "opensuse": "suse"}


def system() -> str:
    """The row of the tables above for this computer."""
    if sys.platform in ("darwin", "win32"):
        return {"darwin": "macos", "win32": "windows"}[sys.platform]
    try:
        release = platform.freedesktop_os_release()
    except OSError:
        return "linux"
    names = [release.get("ID", ""), *release.get("ID_LIKE", "").split()]
    known = (FAMILIES.get(name, name) for name in names)
    return next((name for name in known if name in PROCESSOR), "linux")


def for_processor() -> str:
    """Package that makes the processor a device."""
    intel = platform.machine() in ("x86_64", "AMD64") and sys.platform in ("linux", "win32")
    return f"{INTEL}, or {PROCESSOR[system()]}" if intel else PROCESSOR[system()]


def for_graphics() -> str:
    """Package that makes a graphics card a device."""
    return GRAPHICS[system()]
