from . import (
    appendix_a as appendix_a,
)
from . import (
    batch as batch,
)
from . import (
    benchmark as benchmark,
)
from . import (
    cli as cli,
)
from . import (
    correctors as correctors,
)
from . import (
    effects as effects,
)
from . import (
    exceptions as exceptions,
)
from . import (
    fitting as fitting,
)
from . import (
    io as io,
)
from . import (
    missions as missions,
)
from . import (
    models as models,
)
from . import (
    photometry as photometry,
)
from . import (
    plotting as plotting,
)
from . import (
    scene as scene,
)
from . import (
    simulation as simulation,
)
from ._version import __version__ as __version__
from .appendix_a import Target as Target
from .appendix_a import generate_target as generate_target
from .correctors import PLDCorrector as PLDCorrector
from .fitting import TPFFit as TPFFit
from .fitting import fit_tpf as fit_tpf
from .io import read_pixels as read_pixels
from .io import read_truth as read_truth
from .io import write_tpf as write_tpf
from .missions import MISSIONS as MISSIONS
from .missions import Mission as Mission
from .models import (
    PRF as PRF,
)
from .models import (
    BivariateGaussianPSF as BivariateGaussianPSF,
)
from .models import (
    SensitivityPolynomial as SensitivityPolynomial,
)
from .models import (
    TabulatedPSF as TabulatedPSF,
)
from .models import (
    TransitModel as TransitModel,
)
from .models import (
    integrate_pixels as integrate_pixels,
)
from .photometry import cdpp as cdpp
from .scene import (
    Detector as Detector,
)
from .scene import (
    Motion as Motion,
)
from .scene import (
    Scene as Scene,
)
from .scene import (
    Star as Star,
)
from .scene import (
    read_detector as read_detector,
)
from .scene import (
    read_scene as read_scene,
)
from .simulation import Observation as Observation
from .simulation import inject as inject
from .simulation import simulate as simulate
