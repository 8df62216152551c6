"""Cosmic rays: charge along straight tracks, and its rejection on board of TESS."""

from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.special import ndtr

from scope_models._arrays import plain_array
from scope_models._checks import number
from scope_models.effects.base import Drawn, Effect, number_of_events

__all__ = ["CosmicRays"]

# Points per pixel at which the charge of a track is put down.
_POINTS = 16
_READS = 10


@dataclass(frozen=True, eq=False, repr=False)
class CosmicRays(Effect):
    r"""Particles that cross the detector from all directions.

    The number of hits is a Poisson number, their places and azimuths are uniform, and the angle
    :math:`\theta` to the normal has the density :math:`2 \cos\theta` in :math:`\cos\theta`, as of
    particles from everywhere through a plane. A particle crosses a layer of the depth h and leaves
    charge in proportion to its path, :math:`h / \cos\theta`, along a track of the length
    :math:`h \tan\theta` on the detector.

    Parameters
    ----------
    rate : float or Quantity, optional
        Hits per square centimeter and second. The default, 5, is that of ETEM2, the simulator of
        the Kepler project; simulators of PLATO use 10.
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

    With ``rejection`` a read that a ray has hit is nearly always the highest of its ten, and is
    dropped; what stays is the bias of the other nine, whose lowest is still dropped
    (`rejected_shift`). The reads are taken as normal, and a pixel as hit at most once in ten
    reads. The smaller noise of trimmed sums is not a part of this effect.

    Examples
    --------
    >>> from scope_models import Detector, Motion, Star, simulate
    >>> from scope_models.effects import CosmicRays
    >>> scene = Star(12.0), Detector.k2(), Motion.still(100)
    >>> truth = simulate(*scene, seed=1, effects=[CosmicRays()]).truth
    >>> 700 < len(truth.tables["COSMICRAYS"]) < 1500
    True
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
        x = generator.uniform(-0.5 - margin, nx - 0.5 + margin, n)
        y = generator.uniform(-0.5 - margin, ny - 0.5 + margin, n)
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
    r"""Return the mean shift by a charge in one of ten normal reads after the rejection.

    Of ten reads the highest and the lowest are dropped. Nine have the mean 0 and the standard
    deviation 1, one has the mean d. The mean of the other eight's sum is

    .. math:: d - \langle \max \rangle - \langle \min \rangle,

    with the distributions :math:`\Phi^9(z)\, \Phi(z - d)` of the highest and
    :math:`1 - [1 - \Phi(z)]^9 [1 - \Phi(z - d)]` of the lowest. It is 0.8 d for small d, and
    1.485, the mean of the highest of nine, for large d. Charge and shift are in standard deviations
    of a read.
    """
    return np.interp(plain_array(charge, "", "charge"), *_shift_table())


@cache
def _shift_table():
    charge = np.concatenate([np.linspace(0, 12, 241), [20.0]])
    z = np.linspace(-9, 30, 7801)
    other = ndtr(z - charge[:, np.newaxis])
    # Means of highest and lowest by the integrals of their distributions over the grid.
    highest = z[-1] - np.trapezoid(ndtr(z) ** (_READS - 1) * other, z)
    lowest = z[0] + np.trapezoid(ndtr(-z) ** (_READS - 1) * (1 - other), z)
    return charge, charge - highest - lowest
