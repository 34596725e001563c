"""The names of nouns, by family. A new noun is one file and one line here, or `register` in a package of one's own."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from difflib import get_close_matches
from functools import cache
from importlib import import_module
from importlib.metadata import entry_points
from typing import Any

from vamgpu.errors import BadInput

GROUP = "vamgpu.nouns"
"""Entry points of installed packages that name nouns: ``"vessel.toy" = "toys.vessels:Toy"``."""


@dataclass(frozen=True)
class Family:
    """Nouns that can stand for each other.

    nouns: kind → "module:Class".  stands: "module:Type" that constructors ask for where any of them will do.  default:
    the kind that is meant where none is said.
    """

    nouns: dict[str, str] = field(default_factory=dict)
    stands: str = ""
    default: str | None = None


FAMILIES: dict[str, Family] = {
    "grid": Family({"grid": "vamgpu.geometry:Grid"}, default="grid"),
    "beam": Family({"beam": "vamgpu.geometry:Beam"}, default="beam"),
    "motion": Family({"turntable": "vamgpu.geometry:Turntable"}, default="turntable"),
    "vessel": Family(
        {
            "vial": "vamgpu.optics.vial:Vial",
            "vat": "vamgpu.optics.vat:Vat",
            "graded": "vamgpu.optics.graded:GradedVial",
            "aimed": "vamgpu.optics.beams:Aimed",
            "fan": "vamgpu.optics.beams:Fan",
            "occluded": "vamgpu.optics.occluder:Occluded",
            "air": "vamgpu.operators.light:OpenAir",
        },
        stands="vamgpu.geometry:Vessel",
    ),
    "light": Family(
        {"cone": "vamgpu.optics.rising:Cone", "inclined": "vamgpu.optics.rising:Inclined"},
        stands="vamgpu.operators.oblique:Rising",
    ),
    "index": Family({"formula": "vamgpu.optics.index_field:FormulaField"}, default="formula"),
    "region": Family({"region": "vamgpu.optics.index_field:Region"}, default="region"),
    "defocus": Family({"defocus": "vamgpu.operators.defocus:Defocus"}, default="defocus"),
    "wobble": Family({"wobble": "vamgpu.operators.wobble:Wobble"}, default="wobble"),
    "diffusion": Family({"diffusion": "vamgpu.chemistry.diffusion:Diffusion"}, default="diffusion"),
    "film": Family({"film": "vamgpu.optics.film:Film"}, default="film"),
    "wrap": Family({"roller": "vamgpu.optics.roller:Roller"}, default="roller", stands="vamgpu.web:Wrap"),
    "lens": Family({"tunable": "vamgpu.optics.lens:TunableLens"}, default="tunable"),
    "display": Family({"display": "vamgpu.webs.display:Display"}, default="display"),
    "response": Family(
        {
            "linear": "vamgpu.methods:Linear",
            "logistic": "vamgpu.methods:Logistic",
            "generalized": "vamgpu.methods:GeneralizedLogistic",
            "interpolated": "vamgpu.methods:Interpolated",
        },
        stands="vamgpu.losses.response:Response",
    ),
    "loss": Family({"band": "vamgpu.losses.band:Band"}, stands="vamgpu.losses.loss:Loss"),
    "method": Family(
        {
            "window": "vamgpu.methods:ProcessWindow",
            "recipe": "vamgpu.methods:Recipe",
            "fbp": "vamgpu.methods:FilteredBackProjection",
            "cal": "vamgpu.methods:GradientDescent",
            "osmo": "vamgpu.methods:OSMO",
            "penalty": "vamgpu.methods:PenaltyMinimization",
            "bclp": "vamgpu.methods:BCLP",
            "lbfgs": "vamgpu.methods:LBFGS",
        },
        stands="vamgpu.methods.method:Method",
        default="window",
    ),
    "rule": Family(
        {
            "sc": "vamgpu.methods.dual:SingleColor",
            "sc2": "vamgpu.methods.dual:Tolerant",
            "dc": "vamgpu.methods.dual:DualColor",
            "least squares": "vamgpu.methods.dual:LeastSquares",
        },
        default="least squares",
    ),
    "operator": Family(
        {
            "projection": "vamgpu.operators.projection:Projection",
            "oblique": "vamgpu.operators.oblique:Oblique",
            "defocused": "vamgpu.operators.defocus:Defocused",
            "wobbled": "vamgpu.operators.moves:Wobbled",
            "tiles": "vamgpu.operators.moves:Tiles",
            "spread": "vamgpu.chemistry.diffusion:Spread",
            "composed": "vamgpu.operators.compose:Composed",
            "sum": "vamgpu.operators.compose:Sum",
        },
        stands="vamgpu.operators.linear:LinearOperator",
    ),
}


def register(family: str, kind: str, path: str, *, stands: str = "") -> None:
    """Name a noun, so that job files, manifests and the list of keys know it.

    Args:
        family: such as "vessel"; a new name begins a family, whose nouns stand for the type ``stands``.
        kind: what files call it.
        path: "module:Class" of a class that `fields_of` can read.

    Raises:
        BadInput: the kind is that of another noun.
    """
    nouns = FAMILIES.setdefault(family, Family(stands=stands)).nouns
    if nouns.setdefault(kind, path) != path:
        raise BadInput(f"{family} {kind!r} is {nouns[kind]}; wanted another name for {path}")


@cache
def installed() -> None:
    """Register what installed packages name; once."""
    for entry in entry_points(group=GROUP):
        family, _, kind = entry.name.partition(".")
        register(family, kind, entry.value)


def families() -> dict[str, Family]:
    """All families, with what installed packages name."""
    installed()
    return FAMILIES


def family(name: str) -> Family:
    """A family by name; raises `BadInput`."""
    if name not in families():
        raise BadInput(f"no family {name!r} of nouns; there are {', '.join(FAMILIES)}")
    return FAMILIES[name]


def find(name: str, kind: str) -> type[Any]:
    """The class of a kind; raises `BadInput`."""
    nouns = family(name).nouns
    if kind not in nouns:
        raise BadInput(f"no {name} {kind!r}; wanted one of {', '.join(nouns)}{nearest(kind, nouns)}")
    return load(nouns[kind])


def nearest(name: Any, known: Iterable[str]) -> str:
    """What a name that is unknown was meant to be, to end a complaint."""
    close = get_close_matches(str(name), list(known), n=1)
    return f": did you mean {close[0]!r}?" if close else ": correct the name"


def load(path: str) -> Any:
    """What "module:name" says."""
    module, _, name = path.partition(":")
    return getattr(import_module(module), name)


def name_of(cls: type[Any]) -> tuple[str, str] | None:
    """Family and kind of a class; None for one that has no name."""
    for name, members in families().items():
        for kind, path in members.nouns.items():
            if path.endswith(f":{cls.__name__}") and load(path) is cls:
                return name, kind
    return None


def families_of(cls: type[Any]) -> tuple[tuple[str, str | None], ...]:
    """(family, kind) of the nouns that a constructor takes which asks for ``cls``; kind is None for a whole family."""
    for name, members in families().items():
        if members.stands.endswith(f":{cls.__name__}") and load(members.stands) is cls:
            return ((name, None),)
    one = name_of(cls)
    return () if one is None else (one,)
