"""What some tests need besides Python: skipped with the remedy where it is missing, failed where all must be there."""

from __future__ import annotations

import os
import shutil
from typing import NoReturn

import pytest

COMPLETE = "VAMGPU_TESTS_COMPLETE"
"""Environment variable that turns a missing thing into a failure."""


def missing(remedy: str) -> NoReturn:
    """Skip the test that asks, saying what to install; fail it on a machine that is to have everything."""
    if os.environ.get(COMPLETE):
        pytest.fail(remedy)
    pytest.skip(remedy)


def program(names: tuple[str, ...], remedy: str) -> str:
    """Path of the first of some programs that is installed."""
    return next(filter(None, map(shutil.which, names)), None) or missing(remedy)


def browser() -> str:
    """Path of a browser that Playwright can drive."""
    return program(("chromium", "chromium-browser", "google-chrome"), "install a browser: apt install chromium")


def compiler() -> str:
    """Path of a C++ compiler."""
    return program(("g++", "clang++"), "the firmware is tested as compiled for this computer: apt install g++")
