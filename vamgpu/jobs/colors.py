"""Jobs of two colors: patterns that cure, patterns that inhibit, a folder for each, and one proof of both."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from vamgpu.errors import BadInput
from vamgpu.jobs.model import JobFile
from vamgpu.methods.dual import Colors, DualPlan, superpose
from vamgpu.methods.dual.colors import Pair
from vamgpu.methods.part import reach_of
from vamgpu.methods.plan_folder import PlanRecord
from vamgpu.metrics import score, score_slices
from vamgpu.operators.reductions import window
from vamgpu.optics.beams import with_absorption
from vamgpu.printing.proof import Proof


def recolored(file: JobFile) -> JobFile:
    """A job whose vessel has the absorption of the second color. Raises `BadInput` for a job without a resin."""
    assert file.colors is not None
    for name in ("vial", "vat", "vessel"):
        vessel = getattr(file, name)
        if vessel is not None:
            return file.model_copy(update={name: with_absorption(vessel, file.colors.absorption)})
    raise BadInput(
        "[colors] got no vessel; expected [vial], [vat] or [vessel], whose resin absorbs the two colors differently"
    )


def superposed(file: JobFile, visible: Any, uv: Any, target: Any, progress: Callable[[float], None]) -> DualPlan:
    """Patterns of both colors for a target."""
    assert file.colors is not None
    rule = file.colors.rule
    passes = getattr(rule, "iterations", None) or getattr(rule, "passes", None) or 1
    colors = Colors(visible, uv, strength=file.colors.strength)
    return superpose(colors, target, rule, progress=lambda record: progress(min(record.number / passes, 1.0)))


def recorded(plan: DualPlan, target: Any) -> PlanRecord:
    """Record of a plan; its window is that of the effective dose."""
    least, leak, greatest = window(plan.dose(), target.on(plan.visible.device), reach_of(target.grid))
    return PlanRecord.of(plan, (least - max(leak, 0.0)) / greatest if greatest > 0 else -1.0)


def subtracted(proof: Proof, strength: float, rule: Any, A: Any, frames: Any) -> Proof:
    """A proof of the first color, with the dose of the second subtracted, as their rule computes it."""
    light = Pair(*(one.irradiance(A.device) for one in (proof.frames, frames)))
    colors = Colors(proof.operator, A, strength=strength)
    own, dose = (rule.dose(colors, light, finer) for finer in (False, True))
    scores = score(dose, proof.target)
    return replace(
        proof, dose=dose, scores=scores, claimed=score(own, proof.target), independent=False, exposure=None, outer=None,
        slices=score_slices(dose, proof.target, scores),
    )  # fmt: skip
