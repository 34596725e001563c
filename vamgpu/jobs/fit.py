"""A resin and a projector fitted to measurements, as printed lines and as tables of job files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from vamgpu.curethrough.resin import GrayFit, Range, WorkingCurve, read_gray
from vamgpu.curethrough.spectrum import LampSpectrum
from vamgpu.errors import BadInput, StorageError
from vamgpu.geometry import positive
from vamgpu.quantity import parse
from vamgpu.storage.atomic import replacing
from vamgpu.units import mJ_cm3, mW_cm2, um


@dataclass(frozen=True)
class Fitted:
    """A working curve, a gray curve in mW/mm², or both. gels: critical dose divided by the dose that just gels."""

    resin: WorkingCurve | None
    gray: GrayFit | None
    gels: float

    @property
    def critical_dose(self) -> float | None:
        """D_c [mJ/mm³]."""
        return None if self.resin is None else self.gels * self.resin.gel_dose.value

    def lines(self) -> tuple[tuple[str, str, str], ...]:
        """(name, value, meaning) of the fitted numbers."""
        found: list[tuple[str, str, str]] = []
        if self.resin is not None and self.critical_dose is not None:
            share, plugs = f"{100 * self.resin.confidence:g} %", self.resin.plugs
            height, gel = self.resin.absorption_height, self.resin.gel_dose
            uncured = f", {self.resin.uncured} of them of height 0" if self.resin.uncured else ""
            found = [
                ("absorption height", f"{height.value / um:.4g} µm", f"{_bounds(height, um)} µm with {share}"),
                ("gel dose", f"{gel.value / mJ_cm3:.4g} mJ/cm³", f"{_bounds(gel, mJ_cm3)} mJ/cm³ with {share}"),
                ("critical dose", f"{self.critical_dose / mJ_cm3:.4g} mJ/cm³", f"{self.gels:g} gel doses"),
                ("spread of heights", f"{self.resin.spread / um:.3g} µm", f"of {plugs} plugs about the curve{uncured}"),
            ]
        if self.gray is not None:
            low, high = self.gray.intensity[0] / mW_cm2, self.gray.intensity[-1] / mW_cm2
            ratio = f"contrast {high / low:.4g} : 1" if low > 0 else "no light at level 0"
            pieces = f"{len(self.gray.levels) - 1} pieces"
            found += [
                ("light", f"{low:.3g} to {high:.4g} mW/cm²", ratio),
                ("spread of light", f"{self.gray.spread / mW_cm2:.3g} mW/cm²", f"of the readings about {pieces}"),
            ]
        return tuple(found)

    def write(self, path: str | Path, *, overwrite: bool = False) -> Path:
        """Write the fitted tables to a TOML file, which a job's ``gray`` may name. Raises `StorageError`."""
        text = ""
        if self.resin is not None and self.critical_dose is not None:
            text += "[printer]\n"
            text += f'absorption_height = "{self.resin.absorption_height.value / um:.6g} um"\n'
            text += f'critical_dose = "{self.critical_dose / mJ_cm3:.6g} mJ/cm3"\n'
        if self.gray is not None:
            text += f'light = "{self.gray.intensity[-1] / mW_cm2:.6g} mW/cm2"\n' if text else ""
            light = ", ".join(f"{value / mW_cm2:.6g}" for value in self.gray.intensity)
            text += ("\n" if text else "") + f"[gray]\nlevels = {list(self.gray.levels)}\nintensity = [{light}]\n"
        with replacing(path, overwrite=overwrite) as draft:
            draft.write_text(text, encoding="utf-8")
        return Path(path)


def fit_files(
    plugs: Path | None, irradiance: str | None, gray: Path | None, pieces: int | None, confidence: float, gels: float,
    out: Path | None = None, lamp: Path | None = None,
) -> Fitted:  # fmt: skip
    """Fit a CSV file of plugs, one of gray levels, or both. Raises `BadInput`, `StorageError`."""
    if out is not None and out.resolve() in {path.resolve() for path in (plugs, gray) if path is not None}:
        raise StorageError(f"{str(out)!r} holds the measurements; choose another path for the fitted tables")
    if plugs is None and gray is None:
        raise BadInput("nothing to fit; expected a CSV file of plugs, or --gray with one of gray levels")
    light = None
    if irradiance is not None:
        try:
            light = parse(irradiance, "an irradiance")
        except ValueError as error:
            raise BadInput(f"irradiance: got {irradiance!r}; {error}") from error
    spectrum = None if lamp is None else LampSpectrum.read(lamp)
    resin = None if plugs is None else WorkingCurve.read(plugs, light, confidence, spectrum)
    return Fitted(resin, None if gray is None else read_gray(gray, pieces), positive("gels", gels))


def _bounds(found: Range, unit: float) -> str:
    return f"{found.low / unit:.4g} to {found.high / unit:.4g}"
