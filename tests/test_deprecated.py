"""Old public names lead to the new ones for one release, and warn where they are used."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, fields
from typing import ClassVar

import pytest

from vamgpu.deprecated import Renamed


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


@pytest.mark.parametrize(("use", "old", "value"), [
    (lambda: Lens().bend(3), "Lens.bend is called focus", 4),
    (lambda: Lens().strength, "Lens.strength is called power", 2.0),
    (lambda: Lens.strength, "Lens.strength is called power", 2.0),
])  # fmt: skip
def test_old_attributes_and_methods_of_a_class(use, old, value):
    with pytest.warns(DeprecationWarning, match=old) as caught:
        assert use() == value
    assert caught[-1].filename == __file__
