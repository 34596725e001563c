"""Rig files of earlier versions in today's words, and roles that follow from the others."""

from __future__ import annotations

from typing import Any

from vamgpu.deprecated import warn_renamed
from vamgpu.errors import BadInput
from vamgpu.schema.registry import find

Path = tuple[str, ...]
MOTOR = ("microsteps", "ramp")
"""Keys that [controller] had and [motion] has."""
TABLES = {"projector": "display", "stage": "motion", "camera": "feedback", "photodiode": "feedback"}
"""Old table → role."""
DRIVERS: dict[str, dict[str, str]] = {
    "projector": {"hdmi": "video"},
    "stage": {},
    "camera": {"genicam": "camera", "emulated": "emulated camera"},
    "photodiode": {"scpi": "power meter", "emulated": "emulated photodiode"},
}
"""Old table → old driver → new one."""


def current(data: dict[str, Any]) -> dict[Path, Path]:
    """Bring a rig file's tables up to date in place and add implied roles; returns old key → new key."""
    moved = _motor(data) if isinstance(data.get("controller"), dict) else {}
    if "stage" in data and "motion" in data and not _cabled(data):
        del data["stage"]  # the emulated rig of earlier versions had both motors
    for old, role in TABLES.items():
        if old in data and (role == "feedback" or role not in data or old == "stage"):
            moved |= _table(data, old, role)
    _complete(data)
    return moved


def _motor(data: dict[str, Any]) -> dict[Path, Path]:
    """The motor out of [controller]; it moves, unless a stage does."""
    box = data["controller"]
    moved: dict[Path, Path] = {(("controller", key)): ("motion", key) for key in MOTOR if key in box}
    motor = {key: box.pop(key) for _, key in moved}
    if moved:
        warn_renamed(
            "[controller] microsteps and ramp", '[motion] driver = "controller" with them', category=FutureWarning
        )
    if isinstance(data.get("motion"), dict):
        data["motion"] |= motor  # by --set, under its old name
    if "motion" in data:
        return moved
    if "stage" in data and (_cabled(data) or box.get("driver") != "emulated"):
        return moved
    data["motion"] = {"driver": "emulated" if box.get("driver") == "emulated" else "controller", **motor}
    if data["motion"]["driver"] == "emulated":
        data["motion"].pop("ramp", None)
    return moved


def _cabled(data: dict[str, Any]) -> bool:
    """Whether a display is on a video cable."""
    return any(
        _of("rig_display", each, "triggered") is False or each.get("driver") == "hdmi" for each in _displays(data)
    )


def _displays(data: dict[str, Any]) -> list[dict[str, Any]]:
    """Its tables, under either name."""
    given = data.get("display", data.get("projector", []))
    return [each for each in (given if isinstance(given, list) else [given]) if isinstance(each, dict)]


def _of(family: str, table: Any, trait: str) -> Any:
    """A trait of the class that a table names; None where there is no such class."""
    try:
        return getattr(find(family, table["driver"]), trait, None)
    except (BadInput, KeyError, TypeError):
        return None


def _table(data: dict[str, Any], old: str, role: str) -> dict[Path, Path]:
    """One table under the name of its role."""
    given = data.pop(old)
    for each in given if isinstance(given, list) else [given]:
        if isinstance(each, dict) and "driver" in each:
            each["driver"] = DRIVERS[old].get(each["driver"], each["driver"])
    moved: dict[Path, Path] = {(old,): (role,)}
    if old == "stage" and isinstance(given, dict) and "steps" in given:
        given["microsteps"] = given.pop("steps")
        moved[(old, "steps")] = (role, "microsteps")
    if role == "feedback":
        before = data.get("feedback", [])
        given = [*(before if isinstance(before, list) else [before]), given]
    data[role] = given
    new = f'[[{role}]] with driver = "{given[-1].get("driver")}"' if role == "feedback" else f"[{role}]"
    warn_renamed(f"the table [{old}]", new, category=FutureWarning)
    return moved


def _complete(data: dict[str, Any]) -> None:
    """Light, clock: the ones that the other parts suggest."""
    light = data.setdefault("light", {})
    if isinstance(light, dict):
        light.setdefault("driver", "controller" if "controller" in data else "display")
    motion = data.get("motion")
    if "clock" in data or not isinstance(motion, dict):
        return
    if _cabled(data):
        data["clock"] = {"driver": "vblank"}
    elif motion.get("driver") in ("controller", "emulated") and "controller" in data:
        data["clock"] = {"driver": "controller"}
    else:
        data["clock"] = {"driver": "stage"}
