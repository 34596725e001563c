"""Jobs of two colors: light that cures, light that undoes its dose, a folder for each, and one proof of both."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from vamgpu.errors import BadInput
from vamgpu.jobs.model import JobFile
from vamgpu.jobs.record import PlanRecord
from vamgpu.methods.dual import Colors, DualPlan, superpose
from vamgpu.methods.part import reach_of
from vamgpu.metrics import score, score_slices
from vamgpu.operators.reductions import window
from vamgpu.schema import fields_of

if TYPE_CHECKING:
    from vamgpu.printing.proof import Proof


def recolored(wanted: JobFile) -> JobFile:
    """A job whose vessel absorbs as it does for the second color. Raises `BadInput` for one that has no resin."""
    assert wanted.colors is not None
    for name in ("vial", "vat", "vessel"):
        vessel = getattr(wanted, name)
        if vessel is not None:
            return wanted.model_copy(update={name: _absorbing(vessel, wanted.colors.absorption)})
    raise BadInput("[colors] got no vessel; wanted [vial], [vat] or [vessel], whose resin absorbs the two differently")


def _absorbing(vessel: Any, absorption: float) -> Any:
    """A vessel, or the one within its wrappers, of another absorption."""
    names = {field.name for field in fields_of(type(vessel))}
    if "absorption" in names:
        return replace(vessel, absorption=absorption)
    if "vessel" in names and vessel.vessel is not None:
        return replace(vessel, vessel=_absorbing(vessel.vessel, absorption))
    raise BadInput(f"[colors] got {vessel!r}, which has no absorption; wanted a vessel that holds resin")


def superposed(wanted: JobFile, visible: Any, uv: Any, target: Any, told: Callable[[float], None]) -> DualPlan:
    """Light of both colors for a target."""
    assert wanted.colors is not None
    rule = wanted.colors.rule
    passes = getattr(rule, "iterations", None) or getattr(rule, "passes", None) or 1
    colors = Colors(visible, uv, strength=wanted.colors.strength)
    return superpose(colors, target, rule, progress=lambda record: told(min(record.number / passes, 1.0)))


def recorded(plan: DualPlan, target: Any) -> PlanRecord:
    """What a folder remembers of it; the window is that of the effective dose."""
    least, leak, greatest = window(plan.dose(), target.on(plan.visible.device), reach_of(target.grid))
    return PlanRecord.of(plan, (least - max(leak, 0.0)) / greatest if greatest > 0 else -1.0)


def subtracted(proof: Proof, strength: float, A: Any, frames: Any) -> Proof:
    """A proof of the first color, with the dose of the second taken off it.

    Args:
        proof: of the first color alone.
        strength: dose of the first that one unit of the second undoes.
        A, frames: operator and frames of the second.
    """
    lights = (one.irradiance(A.device) for one in (proof.frames, frames))
    dose = Colors(proof.operator, A, strength=strength).dose(*lights)
    scores = score(dose, proof.target)
    return replace(
        proof, dose=dose, scores=scores, claimed=scores, slices=score_slices(dose, proof.target, scores), outer=None,
        independent=False, exposure=None,
    )  # fmt: skip
