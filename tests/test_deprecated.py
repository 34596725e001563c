"""Old public names lead to the new ones for one release, and warn where they are used."""

from __future__ import annotations

import sys
import warnings
from dataclasses import dataclass, fields
from types import ModuleType
from typing import Any, ClassVar

import pytest

from vamgpu.deprecated import Renamed, renamed, renamed_arguments
from vamgpu.errors import BadInput


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


def house(monkeypatch: pytest.MonkeyPatch, **given: Any) -> ModuleType:
    module = ModuleType("house")
    module.Lens = Lens  # type: ignore[attr-defined]
    module.__getattr__ = renamed("house", {"Glass": "Lens", "Grid": "vamgpu.geometry.Grid"}, **given)  # type: ignore[method-assign]
    monkeypatch.setitem(sys.modules, "house", module)
    return module


def test_an_old_name_is_the_new_one_and_warns_where_it_is_used(monkeypatch):
    house(monkeypatch)
    with pytest.warns(DeprecationWarning, match=r"house\.Glass is called house\.Lens now") as caught:
        from house import Glass  # pyright: ignore[reportMissingImports]
    assert Glass is Lens and caught[-1].filename == __file__


def test_an_old_name_may_live_in_another_module(monkeypatch):
    from vamgpu.geometry import Grid

    with pytest.warns(DeprecationWarning, match=r"called vamgpu\.geometry\.Grid now"):
        assert house(monkeypatch).Grid is Grid


def test_an_unknown_name_is_refused_or_looked_up(monkeypatch):
    with pytest.raises(AttributeError, match="'house' has no attribute 'Mirror'"):
        _ = house(monkeypatch).Mirror
    assert house(monkeypatch, otherwise=str.lower).Mirror == "mirror"


@pytest.mark.parametrize(("use", "old", "value"), [
    (lambda: Lens().bend(3), "Lens.bend is called focus", 4),
    (lambda: Lens().strength, "Lens.strength is called power", 2.0),
    (lambda: Lens.strength, "Lens.strength is called power", 2.0),
])  # fmt: skip
def test_old_attributes_and_methods_of_a_class(use, old, value):
    with pytest.warns(DeprecationWarning, match=old) as caught:
        assert use() == value
    assert caught[-1].filename == __file__


def test_an_argument_under_its_old_name_reaches_the_function():
    @renamed_arguments(told="progress")
    def write(path, *, progress=None):
        return path, progress

    assert write("a", progress=1) == ("a", 1)
    with pytest.warns(DeprecationWarning, match="argument told of .*write is called progress") as caught:
        assert write("a", told=2) == ("a", 2)  # pyright: ignore[reportCallIssue]
    assert caught[-1].filename == __file__
    with pytest.raises(BadInput, match="got progress and the argument told of .*write, its old name"):
        write("a", told=2, progress=1)  # pyright: ignore[reportCallIssue]


def test_an_old_kind_of_a_file_is_read_with_a_warning():
    from vamgpu import Misaligned
    from vamgpu.schema.read import read

    with pytest.warns(FutureWarning, match="kind 'aimed' is called 'misaligned' now"):
        assert read("vessel", {"kind": "aimed", "offset": "0.1 mm"}) == Misaligned(offset=0.1)


def test_old_fields_of_a_class_reach_its_constructor_its_instances_and_files():
    from vamgpu import BCLP
    from vamgpu.schema.read import read

    with pytest.warns(DeprecationWarning, match="argument price of BCLP.* is called penalty now") as caught:
        method = BCLP(price=(2.0, 1.0))  # pyright: ignore[reportCallIssue]
    assert method == BCLP(penalty=(2.0, 1.0)) and caught[-1].filename == __file__
    with pytest.warns(DeprecationWarning, match="BCLP.price is called penalty now"):
        assert method.price == (2.0, 1.0)
    with pytest.warns(FutureWarning, match="the key price is called penalty now"):
        assert read("method", {"kind": "bclp", "price": [2, 1]}) == method


def test_an_old_key_of_a_section_is_read_with_a_warning():
    from vamgpu.jobs.model import SolveSection

    with pytest.warns(FutureWarning, match="the key pairs is called evaluations now"):
        assert SolveSection.model_validate({"pairs": 12}).evaluations == 12
    with pytest.raises(ValueError, match="pairs\n  Extra inputs are not permitted"):
        SolveSection.model_validate({"pairs": 12, "evaluations": 30})
