"""Each system is told the package that it has."""

from __future__ import annotations

import platform
import sys

import pytest

from vamgpu.cli import remedies

SYSTEMS = [
    ({"ID": "debian"}, "linux", "x86_64", "apt install pocl-opencl-icd", True),
    ({"ID": "mint", "ID_LIKE": "ubuntu debian"}, "linux", "x86_64", "apt install pocl-opencl-icd", True),
    ({"ID": "debian"}, "linux", "aarch64", "apt install pocl-opencl-icd", False),
    ({"ID": "fedora"}, "linux", "x86_64", "dnf install pocl", True),
    ({"ID": "rocky", "ID_LIKE": "rhel centos fedora"}, "linux", "x86_64", "dnf install pocl", True),
    ({"ID": "strange"}, "linux", "x86_64", "package manager", True),
    (None, "linux", "x86_64", "package manager", True),
    ({}, "darwin", "arm64", "part of macOS", False),
    ({}, "win32", "AMD64", "Intel's CPU Runtime", True),
]


@pytest.mark.parametrize(("release", "kind", "machine", "wanted", "intel"), SYSTEMS)
def test_a_system_is_told_its_package(
    release: dict[str, str] | None, kind: str, machine: str, wanted: str, intel: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    def told() -> dict[str, str]:
        if release is None:
            raise OSError("no os-release")
        return release

    monkeypatch.setattr(platform, "freedesktop_os_release", told)
    monkeypatch.setattr(platform, "machine", lambda: machine)
    monkeypatch.setattr(sys, "platform", kind)
    assert wanted in remedies.for_processor()
    assert (remedies.INTEL in remedies.for_processor()) is intel
    assert remedies.for_graphics() == remedies.GRAPHICS[remedies.system()]


def test_both_tables_know_the_same_systems() -> None:
    assert remedies.PROCESSOR.keys() == remedies.GRAPHICS.keys() > set(remedies.FAMILIES.values())
