"""Readings of light behind cuvettes, from a TOML file and its images."""

from __future__ import annotations

from typing import Annotated, ClassVar

from vamgpu.errors import JobError
from vamgpu.jobs.read import CheckedJob
from vamgpu.optics.cuvette import Cuvette
from vamgpu.optics.scattering_fit import PHOTONS, CuvetteSample, MeasuredScattering, fit_scattering
from vamgpu.schema.quantities import Length, Positive
from vamgpu.schema.read import noun
from vamgpu.schema.section import Listed, Named, Section
from vamgpu.storage.images import read_image


class SampleSection(Section):
    """Light behind the cuvette of one thickness, in shares of the beam without a cuvette.

    thickness: path through the resin.  collimated: share that arrives on the meter of collimated light.  total: share
    that arrives in the sphere.  image: image of the paper, with linear gray levels; at least one sample needs one.
    """

    thickness: Length
    collimated: Positive
    total: Positive
    image: Annotated[str | None, Named] = None


class CuvetteFile(Section):
    """Readings of two or more cuvettes of one resin."""

    cuvette: Annotated[Cuvette, noun("cuvette")]
    sample: Annotated[tuple[SampleSection, ...], Listed]


class CuvetteJob(CheckedJob[CuvetteFile]):
    """Checked readings."""

    model: ClassVar[type[CuvetteFile]] = CuvetteFile

    def fitted(self, photons: int = PHOTONS) -> MeasuredScattering:
        """The resin. Raises `JobError`, `BadInput`."""
        return fit_scattering(self.file.cuvette, [self._sample(each) for each in self.file.sample], photons=photons)

    def _sample(self, section: SampleSection) -> CuvetteSample:
        given = section.model_dump()
        if section.image is not None:
            try:
                given["image"] = read_image(self.folder / section.image)
            except OSError as error:
                raise JobError(f"sample.image: cannot read {section.image!r}: {error}") from error
        return CuvetteSample(**given)
