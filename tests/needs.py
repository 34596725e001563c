"""What some tests need besides Python: skipped with the remedy where it is missing, failed where all must be there."""

from __future__ import annotations

import os
import shutil
from typing import Any, NoReturn

import pytest

COMPLETE = "VAMGPU_TESTS_COMPLETE"
"""Environment variable that turns a missing thing into a failure."""
WAIT = 30_000
"""The longest wait of a browser, at its start or for what a page is to show [ms]."""


def missing(remedy: str) -> NoReturn:
    """Skip the test that asks, saying what to install; fail it on a machine that is to have everything."""
    if os.environ.get(COMPLETE):
        pytest.fail(remedy)
    pytest.skip(remedy)


def optional(module: str, remedy: str) -> Any:
    """A module that even complete machines may lack, being gigabytes; skip the tests that ask, saying what to install.

    Args:
        module: Its name.
        remedy: What to install, and why it is not asked for everywhere.
    """
    return pytest.importorskip(module, reason=remedy, exc_type=ImportError)


def program(names: tuple[str, ...], remedy: str) -> str:
    """Path of the first of some programs that is installed."""
    return next(filter(None, map(shutil.which, names)), None) or missing(remedy)


def browser() -> str:
    """Path of a browser that Playwright can drive."""
    return program(("chromium", "chromium-browser", "google-chrome"), "install a browser: apt install chromium")


def page(tools: Any, **options: Any) -> Any:
    """A new page of that browser, closed with its tools. No wait of it is longer than `WAIT`."""
    arguments = ["--no-sandbox", "--disable-gpu"]
    made = tools.chromium.launch(executable_path=browser(), args=arguments, timeout=WAIT).new_page(**options)
    made.set_default_timeout(WAIT)
    return made


def compiler() -> str:
    """Path of a C++ compiler."""
    return program(("g++", "clang++"), "the firmware is tested as compiled for this computer: apt install g++")
