"""The names of components, by family. A new one takes a file and a line here, or `register` in another package."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from difflib import get_close_matches
from functools import cache
from importlib import import_module
from importlib.metadata import entry_points
from typing import Any

from vamgpu.errors import BadInput

NEAR = 0.7  # smallest similarity (of `difflib`) at which a name is suggested for an unknown one
GROUP = "vamgpu.nouns"
"""Entry points of installed packages that register components: ``"vessel.toy" = "toys.vessels:Toy"``."""


@dataclass(frozen=True)
class Family:
    """Components of one interface."""

    nouns: dict[str, str] = field(default_factory=dict)  # kind → "module:Class"
    stands: str = ""  # "module:Type" of constructor arguments that accept any of these components
    default: str | None = None  # kind of a table that does not name one
    word: str = "kind"  # key that names the kind


FAMILIES: dict[str, Family] = {
    "grid": Family({"grid": "vamgpu.geometry:Grid"}, default="grid"),
    "beam": Family({"beam": "vamgpu.geometry:Beam"}, default="beam"),
    "motion": Family({"turntable": "vamgpu.geometry:Turntable"}, default="turntable"),
    "vessel": Family(
        {
            "vial": "vamgpu.optics.vial:Vial",
            "vat": "vamgpu.optics.vat:Vat",
            "double walled": "vamgpu.optics.double_walled_vial:DoubleWalledVial",
            "square": "vamgpu.optics.square_bath:SquareBath",
            "graded": "vamgpu.optics.graded_vial:GradedVial",
            "misaligned": "vamgpu.optics.beams:Misaligned",
            "fan": "vamgpu.optics.beams:Fan",
            "occluded": "vamgpu.optics.occluder:Occluded",
            "air": "vamgpu.operators.ray_table:OpenAir",
        },
        stands="vamgpu.geometry:Vessel",
    ),
    "light": Family(
        {"cone": "vamgpu.optics.rising_beams:Cone", "inclined": "vamgpu.optics.rising_beams:Inclined"},
        stands="vamgpu.operators.oblique:Rising",
    ),
    "index": Family(
        {"formula": "vamgpu.optics.index_field:FormulaField", "grid": "vamgpu.optics.index_field:GridField"},
        default="formula",
    ),
    "film index": Family({"film index": "vamgpu.optics.roller_index:FilmIndex"}, default="film index"),
    "medium": Family({"co-rotating": "vamgpu.operators.medium:CoRotatingMedium"}, default="co-rotating"),
    "rays": Family({"rays": "vamgpu.operators.bundle:RayBundle"}, default="rays"),
    "region": Family({"region": "vamgpu.optics.index_field:Region"}, default="region"),
    "defocus": Family({"defocus": "vamgpu.operators.defocus:Defocus"}, default="defocus"),
    "scattering": Family(
        {"scattering": "vamgpu.optics.scattering:Scattering"},
        stands="vamgpu.operators.photon_table:Scatterer",
        default="scattering",
    ),
    "cuvette": Family({"cuvette": "vamgpu.optics.cuvette:Cuvette"}, default="cuvette"),
    "travel": Family({"travel": "vamgpu.travel:Travel"}, default="travel"),
    "wobble": Family({"wobble": "vamgpu.operators.wobble:Wobble"}, default="wobble"),
    "tolerances": Family({"tolerances": "vamgpu.methods.tolerances:Tolerances"}, default="tolerances"),
    "diffusion": Family({"diffusion": "vamgpu.chemistry.diffusion:Diffusion"}, default="diffusion"),
    "oxygen": Family({"oxygen": "vamgpu.chemistry.oxygen:Oxygen"}, default="oxygen"),
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
            "ramp": "vamgpu.methods.surface:SurfaceRamp",
            "recipe": "vamgpu.methods.recipe:Recipe",
            "fbp": "vamgpu.methods.fbp:FilteredBackProjection",
            "cal": "vamgpu.methods.calgd:GradientDescent",
            "osmo": "vamgpu.methods.osmo:OSMO",
            "penalty": "vamgpu.methods.penalty:PenaltyMinimization",
            "bclp": "vamgpu.methods.bclp:BCLP",
            "lbfgs": "vamgpu.methods.lbfgs:LBFGS",
        },
        stands="vamgpu.methods.method:Method",
        default="ramp",
    ),
    "rule": Family(
        {
            "sc": "vamgpu.methods.dual:SingleColor",
            "sc2": "vamgpu.methods.dual:Tolerant",
            "dc": "vamgpu.methods.dual:DualColor",
            "least squares": "vamgpu.methods.dual:LeastSquares",
            "window": "vamgpu.methods.dual:WidestWindow",
            "kinetics": "vamgpu.methods.joint.rule:ThroughKinetics",
        },
        default="least squares",
    ),
    "operator": Family(
        {
            "projection": "vamgpu.operators.projection:Projection",
            "oblique": "vamgpu.operators.oblique:Oblique",
            "traced": "vamgpu.operators.traced_projection:TracedProjection",
            "defocused": "vamgpu.operators.defocus:Defocused",
            "scattering": "vamgpu.operators.scattering_rings:ScatteringRings",
            "wobbled": "vamgpu.operators.shifts:Wobbled",
            "tiles": "vamgpu.operators.shifts:Tiles",
            "spread": "vamgpu.chemistry.diffusion:Spread",
            "oxygen": "vamgpu.chemistry.oxygen:OxygenModel",
            "composed": "vamgpu.operators.compose:Composed",
            "sum": "vamgpu.operators.compose:Sum",
        },
        stands="vamgpu.operators.linear:LinearOperator",
    ),
    "rig_motion": Family(
        {
            "controller": "vamgpu.hosts.rigs.motions:ControllerMotion",
            "zaber": "vamgpu.hosts.rigs.motions:ZaberMotion",
            "standa": "vamgpu.hosts.rigs.motions:StandaMotion",
            "thorlabs": "vamgpu.hosts.rigs.motions:ThorlabsMotion",
            "stepper": "vamgpu.hosts.rigs.motions:StepperMotion",
            "grbl": "vamgpu.hosts.rigs.motions:GrblMotion",
            "text": "vamgpu.hosts.rigs.motions:TextMotion",
            "tic": "vamgpu.hosts.rigs.motions:TicMotion",
            "tmc2209": "vamgpu.hosts.rigs.motions:Tmc2209Motion",
            "emulated": "vamgpu.hosts.rigs.motions:EmulatedMotion",
        },
        word="driver",
    ),
    "rig_clock": Family(
        {
            "controller": "vamgpu.hosts.rigs.motions:ControllerClock",
            "stage": "vamgpu.hosts.rigs.motions:StageClock",
            "vblank": "vamgpu.hosts.rigs.motions:RefreshClock",
            "free": "vamgpu.hosts.rigs.motions:FreeClock",
        },
        word="driver",
    ),
    "rig_display": Family(
        {
            "alp": "vamgpu.hosts.rigs.displays:AlpDisplay",
            "lightcrafter": "vamgpu.hosts.rigs.displays:LightCrafterDisplay",
            "dlpc900": "vamgpu.hosts.rigs.displays:Dlpc900Display",
            "video": "vamgpu.hosts.rigs.displays:VideoDisplay",
            "emulated": "vamgpu.hosts.rigs.displays:EmulatedDisplay",
        },
        word="driver",
    ),
    "rig_light": Family(
        {
            "controller": "vamgpu.hosts.rigs.optics:ControllerLight",
            "laser": "vamgpu.hosts.rigs.optics:LaserLight",
            "diode laser": "vamgpu.hosts.rigs.optics:DiodeLaserLight",
            "display": "vamgpu.hosts.rigs.optics:DisplayLight",
        },
        word="driver",
    ),
    "rig_lens": Family(
        {
            "optotune": "vamgpu.hosts.rigs.optics:OptotuneLens",
            "optotune-icc": "vamgpu.hosts.rigs.optics:IccLensPart",
            "emulated": "vamgpu.hosts.rigs.optics:EmulatedLensPart",
        },
        word="driver",
    ),
    "rig_feedback": Family(
        {
            "encoder": "vamgpu.hosts.rigs.feedback:EncoderFeedback",
            "index": "vamgpu.hosts.rigs.feedback:IndexFeedback",
            "camera": "vamgpu.hosts.rigs.feedback:CameraFeedback",
            "power meter": "vamgpu.hosts.rigs.feedback:PowerMeterFeedback",
            "photodiode": "vamgpu.hosts.rigs.feedback:PowerMeterFeedback",
            "emulated camera": "vamgpu.hosts.rigs.feedback:EmulatedCameraFeedback",
            "emulated photodiode": "vamgpu.hosts.rigs.feedback:EmulatedPowerMeterFeedback",
        },
        word="driver",
    ),
}


def register(family: str, kind: str, path: str, *, stands: str = "") -> None:
    """Register a component for job files, manifests and the list of keys.

    Args:
        family: Name such as "vessel"; a new name creates a family, whose components implement ``stands``.
        kind: Its name in files.
        path: "module:Class" of a class that `fields_of` can read.
        stands: "module:Type" of constructor arguments that accept any component of a new family.

    Raises:
        BadInput: Another component has this kind.
    """
    nouns = FAMILIES.setdefault(family, Family(stands=stands)).nouns
    if nouns.setdefault(kind, path) != path:
        raise BadInput(f"{family} {kind!r} is {nouns[kind]}; expected another name for {path}")


@cache
def installed() -> None:
    """Register the components of installed packages, only once."""
    for entry in entry_points(group=GROUP):
        family, _, kind = entry.name.partition(".")
        register(family, kind, entry.value)


def families() -> dict[str, Family]:
    """All families, with those of installed packages."""
    installed()
    return FAMILIES


def family(name: str) -> Family:
    """A family by name; raises `BadInput`."""
    if name not in families():
        raise BadInput(f"no family {name!r} of components; there are {', '.join(FAMILIES)}")
    return FAMILIES[name]


REPLACED = {("method", kind): 'the default, "ramp",' for kind in ("best", "widest", "window")}
"""Kinds that were removed → what replaces them."""


def find(name: str, kind: str) -> type[Any]:
    """The class of a kind; raises `BadInput`."""
    nouns = family(name).nouns
    if kind not in nouns:
        raise BadInput(f"no {name} {kind!r}; expected one of {', '.join(nouns)}{remedy(name, kind, nouns)}")
    return load(nouns[kind])


def remedy(name: str, kind: str, known: Iterable[str]) -> str:
    """End of an error message: what replaces a removed kind, or the known one that fits an unknown one."""
    instead = REPLACED.get((name, _plain(kind)))
    if instead:
        return f": {instead} replaces it"
    docs = {each: (load(FAMILIES[name].nouns[each]).__doc__ or "").partition(".")[0] for each in known
            if name in FAMILIES and each in FAMILIES[name].nouns}  # fmt: skip
    word = re.compile(rf"\b{re.escape(kind)}\b", re.IGNORECASE)
    meant = next((each for each, doc in docs.items() if len(kind) > 2 and word.search(doc)), None)
    return nearest(kind, known) if meant is None else f": did you mean {meant!r} ({docs[meant]})?"


def as_known(name: str, known: Iterable[str]) -> str:
    """The known name that differs only in case, hyphens, underscores or spaces; else the name itself."""
    return next((each for each in known if _plain(each) == _plain(name)), name)


def _plain(name: str) -> str:
    return re.sub(r"[-_\s]", "", name).lower()


def nearest(name: Any, known: Iterable[str]) -> str:
    """End of a message on an unknown name: the known one that it resembles."""
    close = nearest_of(name, known)
    return f": did you mean {close!r}?" if close else ": correct the name"


def nearest_of(name: Any, known: Iterable[str]) -> str | None:
    """The known name that is similar to another one; None if none is similar enough."""
    lowered = {each.lower(): each for each in known}
    return next((lowered[near] for near in get_close_matches(str(name).lower(), list(lowered), n=1, cutoff=NEAR)), None)


def load(path: str) -> Any:
    """Object at "module:name"."""
    module, _, name = path.partition(":")
    return getattr(import_module(module), name)


def name_of(cls: type[Any]) -> tuple[str, str] | None:
    """Family and kind of a class; None if it is not registered."""
    for name, members in families().items():
        for kind, path in members.nouns.items():
            if path.endswith(f":{cls.__name__}") and load(path) is cls:
                return name, kind
    return None


def families_of(cls: type[Any]) -> tuple[tuple[str, str | None], ...]:
    """(family, kind) of the components that an argument of type ``cls`` accepts; kind is None for a whole family."""
    for name, members in families().items():
        if members.stands.endswith(f":{cls.__name__}") and load(members.stands) is cls:
            return ((name, None),)
    one = name_of(cls)
    return () if one is None else (one,)
