"""Effects on charge, and those of each mission, most of which are on charge."""

from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.signal import lfilter
from scipy.special import ndtr, xlog1py

from scope_models._arrays import plain_array
from scope_models._checks import integer, number
from scope_models.effects.base import Drawn, Effect, number_of_events
from scope_models.effects.light import Focus
from scope_models.effects.sky import ScatteredLight

__all__ = [
    "BrighterFatter", "ChargeTransferInefficiency", "CosmicRays", "DarkCurrent", "RollingBands",
    "Smear", "Undershoot", "mission_effects",
]  # fmt: skip

_POINTS = 16  # per pixel, at which the charge of a track is put down


@dataclass(frozen=True, eq=False, repr=False)
class Smear(Effect):
    r"""Light of a column that falls into all its pixels while frames are shifted to the readout.

    Without a shutter every pixel spends the time :math:`t_r / N` under each other pixel of its
    column, with the read-out time :math:`t_r` of a frame and N rows. It gathers the part
    :math:`f = t_r / (N\, t_{\mathrm{int}})` of the charge of each of them: 8e-5 for Kepler.

    Parameters
    ----------
    rows : int, optional
        Rows N through which the charge of a pixel is shifted; Kepler: 1070 (KSCI-19033).
    residual : float, optional
        Part that the calibration leaves in the flux; its photon noise stays in any case.

    Notes
    -----
    Only stars on the stamp smear, for others are not known. Nothing is random.

    Examples
    --------
    >>> from scope_models import Detector, Motion, Star, simulate
    >>> from scope_models.effects import Smear
    >>> scene = Star(12.0), Detector.k2(background=0.0), Motion.still(1)
    >>> observation = simulate(*scene, seed=1, effects=Smear())
    >>> print(observation.flux_bkg[0, 0, 5].round(1))
    9.5
    """

    rows: int = integer(1070, 1)
    residual: float = number(0.0, any_sign=True)

    is_light = False  # the response of the pixels is in the charge already

    def pedestal(self, drawn, conditions, part, electrons):
        part_of_column = conditions.read_time / (self.rows * conditions.int_time)
        smear = part_of_column * electrons.sum(axis=1, keepdims=True)
        return smear, smear * (1 - self.residual)


@dataclass(frozen=True, eq=False, repr=False)
class DarkCurrent(Effect):
    r"""Thermal charge that differs from pixel to pixel.

    Parameters
    ----------
    level : float or Quantity, optional
        Mean dark current, e-/s per pixel.
    scatter : float, optional
        Standard deviation of the pixels' dark current over its mean; negative values become 0.
    residual : float, optional
        Part of the deviations from the mean that the calibration leaves in the flux.

    Notes
    -----
    The truth has the dark current of each pixel (e-/s) in the map DARKCURRENT. The mean is always
    subtracted. The defaults are assumed.

    Examples
    --------
    >>> from scope_models import Detector, Motion, Star, simulate
    >>> from scope_models.effects import DarkCurrent
    >>> scene = Star(12.0), Detector.k2(), Motion.still(1)
    >>> truth = simulate(*scene, seed=1, effects=DarkCurrent(10.0)).truth
    >>> print(truth.maps["DARKCURRENT"].mean().round(1))
    9.9
    """

    level: float = number(1.0, "electron / s")
    scatter: float = number(0.1)
    residual: float = number(1.0, any_sign=True)

    is_light = False

    def draw(self, conditions, generator):
        deviates = generator.standard_normal(conditions.shape)
        dark = np.maximum(self.level * (1 + self.scatter * deviates), 0.0)
        return Drawn(maps={"DARKCURRENT": dark})

    def pedestal(self, drawn, conditions, part, electrons):
        dark, seconds = drawn.maps["DARKCURRENT"], conditions.exposure_time
        subtracted = self.level + (1 - self.residual) * (dark - self.level)
        return dark * seconds, subtracted * seconds


@dataclass(frozen=True, eq=False, repr=False)
class CosmicRays(Effect):
    r"""Particles that cross the detector from all directions.

    The number of hits is a Poisson number, places and azimuths are uniform, and the angle
    :math:`\theta` to the normal has the density :math:`2 \cos\theta` in :math:`\cos\theta`, as of
    particles through a plane. In a layer of the depth h they leave charge in proportion to their
    path, :math:`h / \cos\theta`, along a track of the length :math:`h \tan\theta`.

    Parameters
    ----------
    rate : float or Quantity, optional
        Hits per square centimeter and second. ETEM2, the simulator of the Kepler project, has 5,
        those of PLATO 10.
    electrons : float or Quantity, optional
        Mean charge of a hit, electrons.
    pixel_size : float or Quantity, optional
        Side of a pixel, micrometers: 27 for Kepler, 15 for TESS.
    depth : float or Quantity, optional
        Depth h of the layer, micrometers; assumed.
    longest : float or Quantity, optional
        Length at which tracks are cut, pixels.
    rejection : bool, optional
        Whether the highest and the lowest of ten reads are dropped, as on board of TESS.

    Notes
    -----
    The truth has the list COSMICRAYS of all hits that leave charge on the stamp: CADENCE (from
    0), X and Y (where the track begins, pixels), LENGTH (pixels), ANGLE (radians from growing
    columns), and ELECTRONS, the charge of the whole track.

    With ``rejection`` a read that a ray has hit is nearly always the highest of its ten; what
    stays is the bias of the other nine, whose lowest is dropped (`rejected_shift`). The reads are
    taken as normal, and a pixel as hit at most once in ten. The smaller noise of trimmed sums is
    not a part of this effect.

    Examples
    --------
    >>> from scope_models import Detector, Motion, Star, simulate
    >>> from scope_models.effects import CosmicRays
    >>> scene = Star(12.0), Detector.k2(), Motion.still(1)
    >>> truth = simulate(*scene, seed=1, effects=CosmicRays()).truth
    >>> len(truth.tables["COSMICRAYS"])
    15
    """

    rate: float = number(5.0, "1 / (cm2 s)")
    electrons: float = number(2500.0, "electron", positive=True)
    pixel_size: float = number(27.0, "um", positive=True)
    depth: float = number(15.0, "um", positive=True)
    longest: float = number(15.0, "pix", positive=True)
    rejection: bool = False

    place = 1  # a hit is in one read, and does not repel the light of the others

    def __post_init__(self):
        super().__post_init__()
        if not isinstance(self.rejection, bool):
            raise TypeError(f"`rejection` must be True or False, got {self.rejection!r}")

    def draw(self, conditions, generator):
        (ny, nx), margin = conditions.shape, np.ceil(self.longest)
        n_cadences, frames = len(conditions.time), conditions.n_frames
        seconds = conditions.int_time * (frames if self.rejection else conditions.n_reads)
        area = (ny + 2 * margin) * (nx + 2 * margin) * (self.pixel_size * 1e-4) ** 2
        n = number_of_events(generator, self.rate * area * seconds * n_cadences)
        cadence = np.sort(generator.integers(n_cadences, size=n))
        x, y = (generator.uniform(-0.5 - margin, k - 0.5 + margin, n) for k in (nx, ny))
        angle = generator.uniform(0, 2 * np.pi, n)
        tangent = np.sqrt(1 / (1 - generator.random(n)) - 1)
        depth = self.depth / self.pixel_size
        length = np.minimum(depth * tangent, self.longest)
        # The mean path over the depth, with tracks that are cut.
        mean = 2 - 1 / np.hypot(1, self.longest / depth)
        hits = {"CADENCE": cadence, "X": x, "Y": y, "LENGTH": length, "ANGLE": angle}
        hits["ELECTRONS"] = self.electrons / mean * np.hypot(1, length / depth)
        seen = np.unique(_deposits(hits, conditions.shape)[0])
        return Drawn(tables={"COSMICRAYS": {name: values[seen] for name, values in hits.items()}})

    def charge(self, drawn, conditions, part, electrons):
        hits = drawn.tables["COSMICRAYS"]
        start, stop = np.searchsorted(hits["CADENCE"], (part.start, part.start + len(electrons)))
        some = {name: values[start:stop] for name, values in hits.items()}
        hit, row, column, charge = _deposits(some, conditions.shape)
        place = some["CADENCE"][hit] - part.start, row, column
        if not self.rejection:
            np.add.at(electrons, place, charge)
            return
        # One entry for each hit and pixel: the rejection acts on their whole charge.
        keys, entry = np.unique(np.stack([hit, *place]), axis=1, return_inverse=True)
        charge = np.bincount(entry.ravel(), charge, minlength=keys.shape[1])
        place = tuple(keys[1:])
        light = np.maximum(electrons[place] / conditions.n_reads, 0.0)
        sigma = np.maximum(np.sqrt(light + conditions.read_noise**2), 1e-6)
        np.add.at(electrons, place, sigma * rejected_shift(charge / sigma))


def _deposits(hits, shape):
    """Return hit, row, column and charge of all points of tracks that are on a stamp."""
    length = hits["LENGTH"]
    start = hits["Y"], hits["X"]
    outside = (np.maximum(-1 - v, v - size) for v, size in zip(start, shape, strict=True))
    near = np.flatnonzero(np.maximum(*outside) <= length)  # the others do not reach the stamp
    points = np.ceil(length[near] * _POINTS).astype(int) + 1
    hit, angle = np.repeat(near, points), np.repeat(hits["ANGLE"][near], points)
    along = np.arange(hit.size) - np.repeat(np.cumsum(points) - points, points) + 0.5
    along *= np.repeat(length[near] / points, points)
    column = np.rint(hits["X"][hit] + along * np.cos(angle)).astype(int)
    row = np.rint(hits["Y"][hit] + along * np.sin(angle)).astype(int)
    seen = (row >= 0) & (row < shape[0]) & (column >= 0) & (column < shape[1])
    charge = np.repeat(hits["ELECTRONS"][near] / points, points)
    return hit[seen], row[seen], column[seen], charge[seen]


def rejected_shift(charge):
    r"""Return the mean shift by a charge in one of ten reads after the rejection.

    Both are in standard deviations of a read. If nine have the mean 0 and one d, the sum without
    the highest and the lowest has the mean :math:`d - \langle \max \rangle - \langle \min \rangle`,
    with the distributions :math:`\Phi^9(z)\, \Phi(z - d)` of the highest and
    :math:`1 - [1 - \Phi(z)]^9 [1 - \Phi(z - d)]` of the lowest.
    """
    return np.interp(plain_array(charge, "", "charge"), *_shift_table())


@cache
def _shift_table():
    charge = np.concatenate([np.linspace(0, 12, 241), [20.0]])
    z = np.linspace(-9, 30, 7801)
    other = ndtr(z - charge[:, np.newaxis])
    # Means of highest and lowest by the integrals of their distributions over the grid.
    highest = z[-1] - np.trapezoid(ndtr(z) ** 9 * other, z)
    lowest = z[0] + np.trapezoid(ndtr(-z) ** 9 * (1 - other), z)
    return charge, charge - highest - lowest


@dataclass(frozen=True, eq=False, repr=False)
class BrighterFatter(Effect):
    r"""Charge that pushes the borders of its pixel inwards: bright stars are wider.

    In each read the charge :math:`q_i` of a pixel repels what arrives; over the border to each of
    its four neighbors j moves

    .. math:: \Delta_{ij} = \frac{k}{2 W} \left(q_i^2 - q_j^2\right) .

    The variance of an image grows by :math:`k \sum q^2 / (W \sum q)` along each axis: a Gaussian
    star of the standard deviation :math:`\sigma` whose brightest pixel is full is wider by about
    :math:`k / 4 \sigma^2`.

    Parameters
    ----------
    coefficient : float, optional
        Coefficient k, square pixels. The default makes a star of 0.5 px wider by 2 % at full
        well, as measured on other CCDs (Antilogus et al. 2014, Guyonnet et al. 2015).
    full_well : float or Quantity, optional
        Charge W, electrons; the default is Kepler's median.

    Notes
    -----
    Nothing is random, and ``observation.model()`` is before it. The background moves, too. All
    charge stays on the stamp.

    Examples
    --------
    >>> from scope_models import Detector, Motion, Star, simulate
    >>> from scope_models.effects import BrighterFatter
    >>> scene = Star(12.0), Detector.k2(), Motion.still(1)
    >>> fat = simulate(*scene, seed=1, noise=False, effects=BrighterFatter())
    >>> print((fat.flux[0, 5, 5] / fat.model()[0, 5, 5]).round(3))
    0.983
    """

    coefficient: float = number(0.02)
    full_well: float = number(1.08e6, "electron", positive=True)

    def charge(self, drawn, conditions, part, electrons):
        squares = self.coefficient / (2 * self.full_well * conditions.n_reads) * electrons**2
        for axis in (1, 2):
            moved = -np.diff(squares, axis=axis).swapaxes(1, axis)
            pixels = electrons.swapaxes(1, axis)
            pixels[:, :-1] -= moved
            pixels[:, 1:] += moved


@dataclass(frozen=True, eq=False, repr=False)
class Undershoot(Effect):
    r"""Readout electronics that read too little after a bright pixel.

    Along a row, in the order of growing columns, a pixel loses

    .. math:: a \sum_{k \ge 1} e^{-(k - 1) / d}\, (q_{j - k} - q_0)

    with the charge :math:`q_0` of the stamp's first pixel in the row, so that a flat field stays.

    Parameters
    ----------
    amplitude : float, optional
        Part a that the next pixel loses; 0.0039 for Kepler.
    decay : float or Quantity, optional
        Length d in which it decays by e, pixels.
    residual : float, optional
        Part that the calibration leaves in the flux. RAW_CNTS have all of it.

    Notes
    -----
    Nothing is random, and ``observation.model()`` is before it. The calibration inverts it, as
    those of the missions do.

    Examples
    --------
    >>> import numpy as np
    >>> from scope_models.effects import Undershoot
    >>> row = np.array([[[0.0, 1000.0, 0.0, 0.0]]])
    >>> Undershoot().readout(None, None, slice(0, 1), row)
    >>> print(row.round(2))
    [[[   0.   1000.     -3.9    -3.19]]]
    """

    amplitude: float = number(0.0039)
    decay: float = number(5.0, "pix", positive=True)
    residual: float = number(0.0, any_sign=True)

    place = 1  # the amplifier is behind the transfers

    def readout(self, drawn, conditions, part, electrons):
        self._feed(electrons, -self.amplitude, np.exp(-1 / self.decay))

    def calibrate(self, drawn, conditions, part, electrons):
        before = electrons.copy()
        self._feed(before, self.amplitude, np.exp(-1 / self.decay) + self.amplitude)
        electrons += (1 - self.residual) * (before - electrons)

    @staticmethod
    def _feed(electrons, part, left):
        """Add a part of each pixel to those after it, times ``left`` for each further one."""
        electrons += lfilter([0.0, part], [1.0, -left], electrons - electrons[..., :1], axis=-1)


@dataclass(frozen=True, eq=False, repr=False)
class ChargeTransferInefficiency(Effect):
    r"""Charge that stays behind when the rows, and then the pixels of a row, are transferred.

    Each transfer leaves the part :math:`\epsilon` of a packet in its pixel for the next packet. Of
    charge that needs N transfers to the output, the part

    .. math:: P_k = \binom{N + k - 1}{k}\, (1 - \epsilon)^N\, \epsilon^k

    arrives k pixels late, in a trail to larger rows and columns.

    Parameters
    ----------
    parallel, serial : float, optional
        Part :math:`\epsilon`, below 0.1, for rows and for the pixels of a row. The defaults are
        assumed.
    rows, columns : int, optional
        Transfers of the stamp's first row and column; each next one needs one more. The default
        is the middle of a CCD of 1024 x 1100 pixels.

    Notes
    -----
    Nothing is random, and ``observation.model()`` is before it. Beyond the edges the charge is
    taken to be that of the first row and column; trails that leave the stamp are lost.

    References
    ----------
    Janesick, J. R. 2001, "Scientific Charge-Coupled Devices", SPIE Press, chapter 5.

    Examples
    --------
    >>> import numpy as np
    >>> from scope_models.effects import ChargeTransferInefficiency
    >>> row = np.array([[[0.0, 0.0, 1000.0, 0.0, 0.0]]])
    >>> ChargeTransferInefficiency(serial=1e-4, columns=98).readout(None, None, slice(0, 1), row)
    >>> print(row.round(2))
    [[[  0.     0.   990.05   9.9    0.05]]]
    """

    parallel: float = number(1e-5, below=0.1)
    serial: float = number(1e-5, below=0.1)
    rows: int = integer(512, 1)
    columns: int = integer(550, 1)

    def readout(self, drawn, conditions, part, electrons):
        ny, nx = electrons.shape[1:]
        if self.parallel:
            edge = electrons[:, :1].copy()
            electrons[...] = edge + _late(self.parallel, self.rows, ny) @ (electrons - edge)
        if self.serial:
            edge = electrons[..., :1].copy()
            electrons[...] = edge + (electrons - edge) @ _late(self.serial, self.columns, nx).T


def _late(epsilon, transfers, n):
    """Return the part of pixels' charge (column) that arrives in each pixel (row), ``(n, n)``."""
    k = np.arange(n)
    number = (transfers + k)[:, np.newaxis]
    ratio = np.where(k == 0, 1.0, (number + k - 1) / np.maximum(k, 1) * epsilon)
    parts = np.cumprod(ratio, axis=1) * np.exp(xlog1py(number, -epsilon))
    return np.tril(parts[k, np.subtract.outer(k, k)])


@dataclass(frozen=True, eq=False, repr=False)
class RollingBands(Effect):
    r"""Episodes of an oscillation of the electronics, seen as bands that roll over the rows.

    The bias of all pixels of a row y changes by

    .. math:: B(y, t) = \sum_i a_i\, e^{-(t - t_i)^2 / 2 d^2}
              \sin\left(2 \pi \left[\frac{y - v (t - t_i)}{\lambda} + \phi_i\right]\right) .

    Parameters
    ----------
    rate : float or Quantity, optional
        Mean number of episodes per day. All defaults but the amplitude are assumed.
    amplitude : float or Quantity, optional
        Mean amplitude :math:`a_i`, e-/s per pixel, of an exponential distribution. The default is
        20 ppm of the flux of a star of Kp 12, below which Kepler's bands stay.
    duration : float or Quantity, optional
        Standard deviation d of an episode in time, days.
    spacing : float or Quantity, optional
        Period :math:`\lambda` of the bands, pixels.
    speed : float or Quantity, optional
        Speed v of the bands, pixels per day.

    Notes
    -----
    The truth has the list ROLLINGBANDS with TIME, AMPLITUDE and PHASE (periods) of each episode,
    and the amplitude of each cadence (e-/s) in the column ROLLINGBANDS. Cadences in which it is
    larger than half the mean amplitude have the mission's quality bit, where it has one. Bands
    have no photon noise and are not part of ``observation.model()``.

    Examples
    --------
    >>> from scope_models import Detector, Motion, Star, simulate
    >>> from scope_models.effects import RollingBands
    >>> scene = Star(12.0), Detector.k2(), Motion.still(500)
    >>> truth = simulate(*scene, seed=1, effects=RollingBands(rate=0.3)).truth
    >>> print(truth.columns["ROLLINGBANDS"].max().round(1))
    8.6
    """

    rate: float = number(0.1, "1 / day")
    amplitude: float = number(3.5, "electron / s")
    duration: float = number(0.5, "day", positive=True)
    spacing: float = number(20.0, "pix", positive=True)
    speed: float = number(40.0, "pix / day", any_sign=True)

    place = 2  # the electronics that oscillate are behind the amplifier

    def draw(self, conditions, generator):
        time, days = conditions.time, conditions.cadence_days
        start, length = time[0] - days / 2, time[-1] - time[0] + days
        n = number_of_events(generator, self.rate * length)
        episodes = {
            "TIME": np.sort(start + length * generator.random(n)),
            "AMPLITUDE": self.amplitude * generator.standard_exponential(n),
            "PHASE": generator.random(n),
        }
        size = np.abs(self._waves(episodes, time).sum(axis=0))
        return Drawn({"ROLLINGBANDS": size}, tables={"ROLLINGBANDS": episodes})

    def _waves(self, episodes, time):
        """Return the complex amplitude of each episode at row 0, (n_episodes, n_cadences)."""
        start, amplitude, phase = (values[:, np.newaxis] for values in episodes.values())
        since = time - start
        size = amplitude * np.exp(-((since / self.duration) ** 2) / 2)
        return size * np.exp(2j * np.pi * (phase - self.speed * since / self.spacing))

    def readout(self, drawn, conditions, part, electrons):
        wave = self._waves(drawn.tables["ROLLINGBANDS"], conditions.time[part]).sum(axis=0)
        rows = np.exp(2j * np.pi * np.arange(electrons.shape[1]) / self.spacing)
        bands = conditions.exposure_time * np.multiply.outer(wave, rows).imag
        electrons += bands[:, :, np.newaxis]

    def quality(self, drawn, conditions):
        return conditions.bit("rolling_band") * (drawn.columns["ROLLINGBANDS"] > self.amplitude / 2)


def mission_effects(detector):
    """Return the effects that a mission's detector has.

    Those of Kepler and K2 are `CosmicRays`, `Smear`, `Undershoot` and `RollingBands`, whose
    defaults are Kepler's. K2 has a `Focus`, too, that changes by 1 % over a campaign of 80 days, as
    the fitted widths of real stars of campaign 5; leave it out with a PRF table, whose width cannot
    change. TESS has `CosmicRays` in pixels of 15 micrometers, with the rejection where the
    detector's cadence has it, and `ScatteredLight`. Effects without a number of the mission are
    left out.

    Parameters
    ----------
    detector : Detector
        The detector.

    Returns
    -------
    tuple of Effect
        The effects, empty if the detector is of no mission.

    Examples
    --------
    >>> from scope_models import Detector
    >>> from scope_models.effects import mission_effects
    >>> [effect.name for effect in mission_effects(Detector.tess())]
    ['CosmicRays', 'ScatteredLight']
    """
    if detector.mission == "TESS":
        return CosmicRays(pixel_size=15.0, rejection=detector.live_fraction < 1), ScatteredLight()
    photometer = CosmicRays(), Smear(), Undershoot(), RollingBands()
    if detector.mission == "K2":
        return Focus(0.005, period=160.0, phase=0.0), *photometer
    return photometer if detector.mission == "Kepler" else ()
