"""The public names for type checkers; tests compare them with those that load when first used."""

from vamgpu.backend import devices as devices
from vamgpu.backend import open_device as open_device
from vamgpu.geometry import Beam as Beam
from vamgpu.geometry import Grid as Grid
from vamgpu.geometry import Turntable as Turntable
from vamgpu.operators.projection import Projection as Projection
from vamgpu.optics.vat import Vat as Vat
from vamgpu.optics.vial import Vial as Vial
from vamgpu.optimize import (
    BCLP as BCLP,
)
from vamgpu.optimize import (
    LBFGS as LBFGS,
)
from vamgpu.optimize import (
    OSMO as OSMO,
)
from vamgpu.optimize import (
    FilteredBackProjection as FilteredBackProjection,
)
from vamgpu.optimize import (
    GradientDescent as GradientDescent,
)
from vamgpu.optimize import (
    PenaltyMinimization as PenaltyMinimization,
)
from vamgpu.optimize import (
    Plan as Plan,
)
from vamgpu.optimize import (
    ProcessWindow as ProcessWindow,
)
from vamgpu.optimize import (
    Recipe as Recipe,
)
from vamgpu.optimize import (
    optimize as optimize,
)
from vamgpu.printing.export import export as export
from vamgpu.printing.frames import Frames as Frames
from vamgpu.printing.gray import GrayCurve as GrayCurve
from vamgpu.printing.pack import pack as pack
from vamgpu.printing.proof import Proof as Proof
from vamgpu.printing.simulate import simulate as simulate
from vamgpu.targets.target import Target as Target

__all__: list[str]
__version__: str
