"""The light of the stars of a scene, before any noise."""

import math
from collections import Counter
from dataclasses import dataclass, fields
from functools import reduce

import numpy as np
from tqdm import tqdm

from scope_models._arrays import plain_tree
from scope_models._values import value_key
from scope_models.effects._noise import bleed, stream
from scope_models.effects.base import Conditions, Exposures
from scope_models.models._gaussian import ROWS
from scope_models.models._series import ImageSeries, is_gaussian

__all__ = [
    "Prepared", "StarLight", "fill_wells", "gather", "pedestal", "pieces", "prepare", "results_of",
    "share_of_target", "shown",
]  # fmt: skip

_PATIENCE = 5.0  # s after which a bar shows the progress
# Pixels and exposures per piece of work: few enough for arrays to stay in the processor's cache.
_PIECE = 1 << 16
_DARK = 1e-13  # part of a star's light below which a pixel is dark; interpolation errs by less
_NARROWEST = 1e-3  # relative width of the PSF from which integrals over pixels find all its light


@dataclass(frozen=True, eq=False)
class StarLight:
    """One star of a scene: places ``(n_cadences, k)`` of k exposures in each cadence, and light.

    ``flux`` is in e-/s at its magnitude, ``passed`` the factor of the effects in each cadence.
    """

    x: np.ndarray
    y: np.ndarray
    weights: np.ndarray
    widths: np.ndarray | None
    flux: float
    relative_flux: np.ndarray
    passed: np.ndarray
    series: ImageSeries
    shares: list
    shape: tuple

    @property
    def window(self):
        """Rows and columns that the star lights, a tuple of two slices."""
        if self.shares:
            return slice(0, self.shape[0]), slice(0, self.shape[1])
        return self.series.window

    def images(self, cadences):
        """Return the star's flux in some cadences, e-/s, without interpixel map."""
        x, y = self.x[cadences], self.y[cadences]
        k = x.shape[1]
        widths = None if self.widths is None else np.repeat(self.widths[cadences], k)
        images = self.series(x.ravel(), y.ravel(), widths)
        if k > 1:
            images = images.reshape(len(x), k, *images.shape[1:])
            images = np.einsum("mkyx,k->myx", images, self.weights)
        if self.shares:
            whole = np.zeros((len(x), *self.shape))
            whole[:, *self.series.window] = images
            place = x @ self.weights, y @ self.weights
            images = sum((share(*place, cadences) for share in self.shares), whole)
        images[images < _DARK] = 0.0
        flux = self.flux * (self.relative_flux * self.passed)[cadences]
        images *= flux[:, np.newaxis, np.newaxis]
        return images


@dataclass(frozen=True, eq=False)
class Prepared:
    """A scene, and all that is computed before its first cadence."""

    scene: object
    conditions: Conditions
    effects: list
    lights: list
    interpixel: np.ndarray
    positions: np.ndarray


def prepare(scene):
    conditions = Conditions.of(scene.detector, scene.motion.time, len(scene.stars))
    effects, counts = [], Counter()
    given = (*scene.detector.effects, *scene.effects)
    for effect in sorted(given, key=_order):
        counts[effect.name] += 1
        generator = stream(scene.seed, f"effect {effect.name} {counts[effect.name]}")
        effects.append((effect, effect.draw(conditions, generator)))
    interpixel = scene.detector.interpixel_map(scene.seed)
    positions = scene.positions
    lights = _star_lights(scene, positions, conditions, effects)
    return Prepared(scene, conditions, effects, lights, interpixel, positions)


def _order(effect):
    """Return what effects are sorted by, whatever the order in which they are given."""
    values = [getattr(effect, item.name) for item in fields(effect)]
    return effect.place, effect.name, repr(plain_tree(values, value_key))


def results_of(effects, method, *arguments):
    """Return what a method of effects returns, without None."""
    found = (getattr(effect, method)(drawn, *arguments) for effect, drawn in effects)
    return [each for each in found if each is not None]


def _star_lights(scene, positions, conditions, effects):
    detector, time = scene.detector, scene.motion.time
    factors = results_of(effects, "width", conditions)
    widths = _checked("width of the PSF", _product(factors), _NARROWEST)
    added = results_of(effects, "exposures", conditions)
    exposures = reduce(Exposures.joined, added, _exposures(scene))
    factors = results_of(effects, "starlight", conditions)
    passed = _checked("light that passes the atmosphere and the telescope", _product(factors))
    passed = np.ones((len(scene.stars), len(time))) * (1.0 if passed is None else passed)
    expanded, lights = exposures.expanded(), []
    response = detector.sensitivity
    for number, (star, (x_0, y_0)) in enumerate(shown(scene.stars, positions.tolist())):
        psf = detector.psf if star.psf is None else star.psf
        if psf is None:
            raise ValueError("`psf` must be given for the star or for the detector")
        moved = exposures if exposures.blur and is_gaussian(psf, response) else expanded
        place = moved.x + x_0, moved.y + y_0
        series = ImageSeries(psf, response, detector.shape, *place, widths, moved.blur, (x_0, y_0))
        flux, relative = detector.flux_from_mag(star.mag), star.relative_flux(time)
        shares = results_of(effects, "shares", conditions, number)
        light = flux, relative, passed[number], series, shares, detector.shape
        lights.append(StarLight(*place, moved.weights, widths, *light))
    return lights


def shown(*values):
    """Return what `zip` does, and show a bar on a terminal where it takes long."""
    rows = zip(*values, strict=True)
    if len(values[0]) == 1:
        return rows
    options = {"leave": False, "disable": None, "delay": _PATIENCE, "unit": " stars"}
    return tqdm(rows, "simulate", len(values[0]), **options)


def _product(factors):
    return math.prod(factors) if factors else None


def _checked(noun, factor, low=0.0):
    """Return the factor of all effects, which must be finite and have no smaller value."""
    if factor is not None and not np.all(np.isfinite(factor) & (factor >= low)):
        raise ValueError(
            f"the relative {noun} must be finite and at least {low:g}, "
            f"got {np.min(factor):g} to {np.max(factor):g}"
        )
    return factor


def _exposures(scene):
    motion = scene.motion
    x, y = motion.x[:, np.newaxis], motion.y[:, np.newaxis]
    if scene.n_sub > 1:
        parts = (np.arange(scene.n_sub) + 0.5) / scene.n_sub - 0.5
        times = motion.time[:, np.newaxis] + parts * scene.detector.cadence_days
        x, y = (np.interp(times, motion.time, values) for values in (motion.x, motion.y))
    return Exposures(x, y, np.full(scene.n_sub, 1 / scene.n_sub))


def gather(prepared, cadences, sums=None, aperture=None):
    """Return the electrons that the light of all stars makes in some cadences, before bleeding.

    ``sums`` grow by each star's light, e-/s: of all cadences, ``(n_stars, ny, nx)``, and in an
    ``aperture``, ``(n_stars, n_cadences)``, with the response of the pixels.
    """
    scene, interpixel = prepared.scene, prepared.interpixel
    n = len(range(*cadences.indices(len(scene.motion))))
    electrons = np.zeros((n, *scene.detector.shape))
    weights = interpixel if aperture is None else interpixel * aperture
    for number, (light,) in enumerate(shown(prepared.lights)):
        images, window = light.images(cadences), light.window
        if sums is not None:
            flat, seen = images.reshape(n, -1), weights[window].ravel()
            whole, in_aperture = sums
            in_aperture[number, cadences] = np.einsum("mp,p->m", flat, seen)
            # One after the other: the sum is the same in pieces of any size.
            first = images[0].copy()
            images[0] += whole[number, *window]
            images.sum(axis=0, out=whole[number, *window])
            images[0] = first
        electrons[:, *window] += images
    electrons *= interpixel * scene.detector.exposure_time
    response = _response(prepared, cadences)
    return electrons if response is None else np.multiply(electrons, response, out=electrons)


def _response(prepared, cadences):
    return _product(results_of(prepared.effects, "response", prepared.conditions, cadences))


def pedestal(prepared, cadences, electrons):
    """Return the charge besides the stars' ``electrons``, and the part that is subtracted.

    Both are expected, ``(ny, nx)`` if they are the same in all cadences, else ``(m, ny, nx)``.
    """
    conditions, response = prepared.conditions, _response(prepared, cadences)
    sky = conditions.background * prepared.interpixel * conditions.exposure_time
    # Light has the response of the pixels and of effects; charge of other kinds has not.
    gain = prepared.interpixel if response is None else prepared.interpixel * response
    added = subtracted = sky if response is None else sky * response
    for effect, drawn in prepared.effects:
        more = effect.pedestal(drawn, conditions, cadences, electrons)
        if more is not None:
            factor = gain if effect.is_light else 1.0
            added, subtracted = added + factor * more[0], subtracted + factor * more[1]
    return added, subtracted


def fill_wells(scene, electrons, background):
    """Let the charge beyond full wells bleed, in place; return the largest part off the stamp."""
    if scene.detector.well_depth is None:
        return 0.0
    depth = scene.detector.well_depth * scene.detector.n_reads
    if electrons.max() <= depth - np.max(background):
        return 0.0
    charge = electrons.sum(axis=(1, 2))
    bleed(electrons, depth, np.minimum(background, depth))
    kept = electrons.sum(axis=(1, 2))
    return float((1.0 - np.divide(kept, charge, out=np.ones_like(kept), where=charge > 0)).max())


def pieces(scene, size=None):
    """Return slices of cadences that together are all of them; ``size`` is rounded up to 16."""
    n = len(scene.motion)
    if size is None:
        # A piece needs up to 80 bytes per pixel, 30 without noise, and the result 12: so many
        # pieces keep the memory below three times the result.
        pixels = n * math.prod(scene.detector.shape)
        size = -(-n // (scene.n_sub * max(5 if scene.noise else 3, -(-pixels // _PIECE))))
    size = max(-(-size // ROWS), 1) * ROWS
    return [slice(start, min(start + size, n)) for start in range(0, n, size)]


def share_of_target(light):
    """Return the target's share in the flux ``(n_stars, n_cadences)``, NaN without light."""
    total = light.sum(axis=0)
    return np.divide(light[0], total, out=np.full(len(total), np.nan), where=total > 0)
