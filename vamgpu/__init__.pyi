"""The public names for type checkers; tests compare them with those that load when first used."""

from vamgpu.backend import devices as devices
from vamgpu.backend import open_device as open_device
from vamgpu.chemistry.aging import fit_aging as fit_aging
from vamgpu.chemistry.diffusion import Diffusion as Diffusion
from vamgpu.chemistry.diffusion import Spread as Spread
from vamgpu.chemistry.efficiency import RotatingLight as RotatingLight
from vamgpu.chemistry.exposure_plan import plan_exposure as plan_exposure
from vamgpu.chemistry.induction import fit_induction as fit_induction
from vamgpu.chemistry.materials import Resin as Resin
from vamgpu.chemistry.phase_plane import stationary as stationary
from vamgpu.chemistry.printrun import PrintRun as PrintRun
from vamgpu.geometry import Beam as Beam
from vamgpu.geometry import Grid as Grid
from vamgpu.geometry import Turntable as Turntable
from vamgpu.hosts.live.live_print import live as live
from vamgpu.jobs.load import load as load
from vamgpu.methods import (
    BCLP as BCLP,
)
from vamgpu.methods import (
    LBFGS as LBFGS,
)
from vamgpu.methods import (
    OSMO as OSMO,
)
from vamgpu.methods import (
    FilteredBackProjection as FilteredBackProjection,
)
from vamgpu.methods import (
    GradientDescent as GradientDescent,
)
from vamgpu.methods import (
    PenaltyMinimization as PenaltyMinimization,
)
from vamgpu.methods import (
    Plan as Plan,
)
from vamgpu.methods import (
    Recipe as Recipe,
)
from vamgpu.methods import (
    SurfaceRamp as SurfaceRamp,
)
from vamgpu.methods import (
    Tolerances as Tolerances,
)
from vamgpu.methods import (
    optimize as optimize,
)
from vamgpu.methods.compare import compared as compared
from vamgpu.methods.dual import Colors as Colors
from vamgpu.methods.dual import superpose as superpose
from vamgpu.methods.joint import KineticModel as KineticModel
from vamgpu.methods.joint import LossWeights as LossWeights
from vamgpu.methods.joint import TwoColorResin as TwoColorResin
from vamgpu.methods.joint import optimize_colors as optimize_colors
from vamgpu.metrics.merit import merit as merit
from vamgpu.operators.bundle import RayBundle as RayBundle
from vamgpu.operators.defocus import Defocus as Defocus
from vamgpu.operators.defocus import Defocused as Defocused
from vamgpu.operators.medium import CoRotatingMedium as CoRotatingMedium
from vamgpu.operators.oblique import Oblique as Oblique
from vamgpu.operators.polar import PolarGrid as PolarGrid
from vamgpu.operators.projection import Projection as Projection
from vamgpu.operators.projector import projector as projector
from vamgpu.operators.ring_projection import RingProjection as RingProjection
from vamgpu.operators.scattering_rings import ScatteringRings as ScatteringRings
from vamgpu.operators.shifts import Tiles as Tiles
from vamgpu.operators.shifts import Wobbled as Wobbled
from vamgpu.operators.spectral import SpectralProjection as SpectralProjection
from vamgpu.operators.traced_projection import TracedProjection as TracedProjection
from vamgpu.operators.web import WebProjection as WebProjection
from vamgpu.operators.wobble import Wobble as Wobble
from vamgpu.optics.beams import Fan as Fan
from vamgpu.optics.beams import Misaligned as Misaligned
from vamgpu.optics.double_walled_vial import DoubleWalledVial as DoubleWalledVial
from vamgpu.optics.film import Film as Film
from vamgpu.optics.graded_vial import GradedVial as GradedVial
from vamgpu.optics.lens import TunableLens as TunableLens
from vamgpu.optics.occluder import Occluded as Occluded
from vamgpu.optics.rising_beams import Cone as Cone
from vamgpu.optics.rising_beams import Inclined as Inclined
from vamgpu.optics.roller import Roller as Roller
from vamgpu.optics.sampling import enough_angles as enough_angles
from vamgpu.optics.sampling import resin_pixel as resin_pixel
from vamgpu.optics.scattering import Scattering as Scattering
from vamgpu.optics.shadowgram import shadowgram as shadowgram
from vamgpu.optics.square_bath import SquareBath as SquareBath
from vamgpu.optics.vat import Vat as Vat
from vamgpu.optics.vial import Vial as Vial
from vamgpu.printing.export import export as export
from vamgpu.printing.focus import FocusMasks as FocusMasks
from vamgpu.printing.frames import Frames as Frames
from vamgpu.printing.gray import GrayCurve as GrayCurve
from vamgpu.printing.pack import pack as pack
from vamgpu.printing.proof import Proof as Proof
from vamgpu.printing.simulate import simulate as simulate
from vamgpu.scene import Body as Body
from vamgpu.scene import Scene as Scene
from vamgpu.targets.designs import gray_wedges as gray_wedges
from vamgpu.targets.designs import usaf as usaf
from vamgpu.targets.spiral import Spiral as Spiral
from vamgpu.targets.target import Target as Target
from vamgpu.web import WebGrid as WebGrid
from vamgpu.webs.stream import Stream as Stream
from vamgpu.webs.timetable import timetable as timetable

__all__: list[str]
__version__: str
