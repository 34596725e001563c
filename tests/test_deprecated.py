"""Old public names lead to the new ones for one release, and warn where they are used."""

from __future__ import annotations

import sys
import warnings
from dataclasses import dataclass, fields
from types import ModuleType
from typing import ClassVar

import pytest

from vamgpu.deprecated import Renamed, renamed
from vamgpu.schema.section import Section


class Lens:
    power = 2.0

    def focus(self, bins: int) -> int:
        return bins + 1

    bend = Renamed("focus")
    strength = Renamed("power")


def test_a_dataclass_with_an_old_name_is_made_without_a_warning():
    with warnings.catch_warnings():
        warnings.simplefilter("error")

        @dataclass(frozen=True)
        class Frame:
            rows: int
            height: ClassVar[Renamed] = Renamed("rows")

    assert [field.name for field in fields(Frame)] == ["rows"]
    with pytest.warns(DeprecationWarning, match="Frame.height is called rows"):
        assert Frame(3).height == 3


def house(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    module = ModuleType("house")
    module.Lens = Lens  # type: ignore[attr-defined]
    module.__getattr__ = renamed("house", {"Glass": "Lens"})  # type: ignore[method-assign]
    monkeypatch.setitem(sys.modules, "house", module)
    return module


def test_an_old_name_is_the_new_one_and_warns_where_it_is_used(monkeypatch):
    house(monkeypatch)
    with pytest.warns(DeprecationWarning, match=r"house\.Glass is called house\.Lens now") as caught:
        from house import Glass  # pyright: ignore[reportMissingImports]
    assert Glass is Lens and caught[-1].filename == __file__


def test_an_unknown_name_is_refused(monkeypatch):
    with pytest.raises(AttributeError, match="'house' has no attribute 'Mirror'"):
        _ = house(monkeypatch).Mirror


@pytest.mark.parametrize(("use", "old", "value"), [
    (lambda: Lens().bend(3), "Lens.bend is called focus", 4),
    (lambda: Lens().strength, "Lens.strength is called power", 2.0),
    (lambda: Lens.strength, "Lens.strength is called power", 2.0),
])  # fmt: skip
def test_old_attributes_and_methods_of_a_class(use, old, value):
    with pytest.warns(DeprecationWarning, match=old) as caught:
        assert use() == value
    assert caught[-1].filename == __file__


def test_an_old_key_of_a_section_is_read_with_a_warning():
    class Solve(Section):
        renamed: ClassVar[dict[str, str]] = {"pairs": "evaluations"}
        evaluations: int

    with pytest.warns(FutureWarning, match="the key pairs is called evaluations now"):
        assert Solve.model_validate({"pairs": 12}).evaluations == 12
    with pytest.raises(ValueError, match="pairs\n  Extra inputs are not permitted"):
        Solve.model_validate({"pairs": 12, "evaluations": 30})
