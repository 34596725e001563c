"""Every public name says what it takes, returns and raises, with shapes and units."""

from __future__ import annotations

import ast
import inspect
import pkgutil
import re
import textwrap
from collections.abc import Callable, Iterator
from dataclasses import is_dataclass
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import Any, get_type_hints

import pytest
from docstring_parser import Docstring, DocstringStyle, parse
from trees import tree_of

import vamgpu
from vamgpu.schema.noun import quantity_in

ARRAY = re.compile(r"ArrayLike|ndarray|NDArray|DeviceArray|Floats|Field3D")
SHAPE = re.compile(r"\[[^\]]+\]|\([^)]*,[^)]*\)")
FLOAT = re.compile(r"\b(float|floating)\b")
UNIT = re.compile(
    r"\[[^\]]+\]|\b(deg|mm)/[sh]\b|dimensionless|[≥%]|\b(share|fraction|factor|ratio|index|weight|exponent|power|times|relative|dose|loss|"
    r"levels?|voxels?|pixels?|columns?|iterations?|concentration|magnification|coefficients?|evaluations?)\b",
    re.IGNORECASE,
)
"""A unit in brackets, or the word that stands for one: a share has none, a dose has that of the target."""
PROPERTIES = (property, cached_property)
UNLISTED = {"calibration", "curethrough", "hosts"}
"""Packages without ``__all__``."""


def listed() -> Iterator[tuple[str, str]]:
    """Module and name of all that ``vamgpu`` and its packages list in ``__all__``."""
    packages = (info.name for info in pkgutil.walk_packages(vamgpu.__path__, "vamgpu.") if info.ispkg)
    for package in ("vamgpu", *packages):
        yield from ((package, name) for name in getattr(import_module(package), "__all__", ()))


def imported() -> Iterator[tuple[str, str]]:
    """Module and name of what packages without ``__all__`` give to other packages, told by the imports of those."""
    folder = Path(vamgpu.__file__).parent
    for file in sorted(folder.rglob("*.py")):
        package, text = file.relative_to(folder).parts[0], file.read_text("utf-8")
        for node in ast.walk(tree_of(text if any(f"from vamgpu.{home}" in text for home in UNLISTED) else "")):
            if isinstance(node, ast.ImportFrom) and node.module is not None:
                home = node.module.removeprefix("vamgpu.").split(".")[0]
                if home in UNLISTED - {package} and (home != "hosts" or node.module == "vamgpu.hosts.rig"):
                    yield from ((node.module, alias.name) for alias in node.names)


def exported() -> Iterator[tuple[str, Any]]:
    """Public functions and classes, each once."""
    seen: set[int] = set()
    for module, name in (*listed(), *imported()):
        value = getattr(import_module(module), name)
        if callable(value) and id(value) not in seen and getattr(value, "__module__", "").startswith("vamgpu"):
            seen.add(id(value))
            yield f"{module}.{name}", value


PUBLIC = {name: value for name, value in exported() if hasattr(value, "__qualname__")}


def own_raises(function: Callable[..., Any]) -> bool:
    """Whether a function's body has a ``raise`` with an exception, functions inside it aside."""
    try:
        (tree,) = ast.parse(textwrap.dedent(inspect.getsource(function))).body
    except (OSError, TypeError):  # made by dataclass
        return False
    left: list[ast.AST] = list(ast.iter_child_nodes(tree))
    while left:
        node = left.pop()
        if isinstance(node, ast.Raise) and node.exc is not None and "NotImplemented" not in ast.unparse(node.exc):
            return True
        if not isinstance(node, (ast.FunctionDef, ast.Lambda, ast.ClassDef)):
            left += ast.iter_child_nodes(node)
    return False


def lacks_of_values(hints: dict[str, Any], text: str, name: str, kind: str) -> Iterator[str]:
    """What the description of one value lacks; ``kind`` is its annotation as written."""
    if ARRAY.search(kind) and not SHAPE.search(text):
        yield f"{name}: an array without its shape"
    measured = quantity_in(hints.get(name))
    a_float = measured is not None and not measured.whole if measured else bool(FLOAT.search(kind))
    if a_float and not UNIT.search(text):
        yield f"{name}: a number without its unit"


def lacks_of_call(function: Callable[..., Any], said: Docstring, *, returns: bool) -> Iterator[str]:
    """What the docstring of a function, or of the class it constructs, lacks."""
    try:
        hints = get_type_hints(function, include_extras=True)
    except NameError:  # names imported for type checkers only
        hints = {}
    entries = ((param.arg_name, param.description or "") for param in said.params)
    written = {name.lstrip("*"): text for names, text in entries for name in names.split(", ")}
    for name, parameter in inspect.signature(function).parameters.items():
        if name in ("self", "cls") or name.startswith("_"):
            continue
        if name not in written:
            yield f"{name}: not under Args"
        else:
            yield from lacks_of_values(hints, written[name], name, str(parameter.annotation))
    for name in written.keys() - inspect.signature(function).parameters.keys():
        if returns:
            yield f"{name}: under Args, and no argument"
    result = str(inspect.signature(function).return_annotation)
    alone = not written and not inspect.signature(function).parameters.keys() - {"self"}
    if returns and not alone and result not in ("None", "<class 'NoneType'>", "NoReturn"):
        if said.returns is None:
            yield "no Returns"
        else:
            yield from lacks_of_values({}, said.returns.description or "", "Returns", result)


def lacks(name: str, value: Any) -> Iterator[str]:
    """Every lack of a public name: of its docstring, of its constructor's and of its methods'."""
    said = parse(inspect.getdoc(value) or "", DocstringStyle.GOOGLE)
    if not said.short_description or not inspect.getdoc(value):
        yield f"{name}: no docstring"
        return
    if not inspect.isclass(value):
        yield from (f"{name} {lack}" for lack in lacks_of_call(value, said, returns=True))
        if own_raises(value) and not said.raises:
            yield f"{name} no Raises"
        return
    if getattr(value, "_is_protocol", False) or issubclass(value, BaseException):
        built: tuple[Any, ...] = ()
    else:
        yield from (f"{name} {lack}" for lack in lacks_of_call(value, said, returns=False))
        built = (vars(value).get("__init__"), vars(value).get("__post_init__"))
    if any(own_raises(part) for part in built if inspect.isfunction(part)) and not said.raises:
        yield f"{name} no Raises"
    for member, kept in vars(value).items():
        if member.startswith("_") or (is_dataclass(value) and member in value.__dataclass_fields__):
            continue
        if isinstance(kept, PROPERTIES):
            if not inspect.getdoc(getattr(value, member)):
                yield f"{name}.{member}: no docstring"
        elif inspect.isfunction(kept) or isinstance(kept, (classmethod, staticmethod)):
            yield from lacks(f"{name}.{member}", getattr(value, member))


@pytest.mark.parametrize("name", PUBLIC)
def test_a_public_name_says_what_it_takes_returns_and_raises(name: str) -> None:
    found = list(lacks(name.rpartition(".")[2], PUBLIC[name]))
    assert not found, "\n".join(found)


def test_the_rules_find_each_lack() -> None:
    def bare(field: np.ndarray, width: float, flag: bool) -> float:  # noqa: F821 # pyright: ignore
        """One line.

        Args:
            field: Values.
            width: How wide it is.
        """
        raise ValueError

    assert list(lacks("bare", bare)) == [
        "bare field: an array without its shape",
        "bare width: a number without its unit",
        "bare flag: not under Args",
        "bare no Returns",
        "bare no Raises",
    ]
