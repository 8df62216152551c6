"""The simulator: a scene gives pixels, and the truth behind them."""

import math
import os
import warnings
from contextlib import contextmanager
from itertools import chain, count

import numpy as np
from astropy.table import Table

from scope_models._checks import checked_integer
from scope_models._threads import one_thread
from scope_models.effects import _noise
from scope_models.exceptions import LostLightWarning
from scope_models.io import Truth
from scope_models.photometry import grown_aperture
from scope_models.scene._files import describe_scene, scene_columns
from scope_models.scene.scene import Scene
from scope_models.simulation import _light
from scope_models.simulation.observation import Observation

__all__ = ["simulate"]

_LARGEST_LOSS = 0.05  # part of the light that may be lost off the stamp without a warning
_LARGEST_COUNT = np.iinfo(np.int32).max
# Standard deviation of the rounding of a number near 1 to single precision.
_ROUNDING = float(np.finfo(np.float32).eps) / 12**0.5
_APERTURE_CADENCES = 64  # enough to choose an aperture


def simulate(stars, detector=None, motion=None, *, keep_model=False, chunk_size=None, **options):
    """Simulate what a detector records of moving stars.

    Each PSF times the sensitivity of the pixels is integrated over them at the star's position,
    times the relative flux and the interpixel map. Then photons of stars and background are drawn
    (Poisson), what the wells do not hold bleeds along the columns, and read noise (normal) and
    digitization come last.

    Parameters
    ----------
    stars : Scene, or Star or sequence of Star
        A scene, or the stars of one; the first is the target.
    detector : Detector, optional
        The pixels, unless a scene is given.
    motion : Motion, optional
        The motion that all stars share, unless a scene is given.
    keep_model : bool, optional
        Whether the truth keeps the noise-free cube.
    chunk_size : int, optional
        Cadences per piece of work, rounded up to a multiple of 16, which does not change the
        result. The default suits the processor's cache.
    **options
        Other fields of `~scope_models.Scene`: ``seed``, ``noise`` (default True), ``n_sub``
        (default 1), ``effects`` (default none), and what identifies the target, as ``target_id``.
        They replace those of a scene.

    Returns
    -------
    Observation
        The pixels and the truth.

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind or outside its domain, the charge of a pixel is beyond
        single precision, or the pixels need more memory than the machine has.

    Warns
    -----
    LostLightWarning
        If more than 5 % of the target's light falls off the stamp where the motion takes it
        farthest, or more than 5 % of the charge of a cadence bleeds off it.

    Notes
    -----
    The same seed gives the same noise wherever the expected electrons of a pixel are the same,
    whatever other effects are switched on and however many cadences follow.

    Wells fill with the charge that is detected: as in real files, a full pixel has no photon noise,
    which is at the ends of the bleeding column, and the errors of the flux are those of the light
    that a pixel holds.

    With very many stars a bar shows the progress on a terminal after five seconds.

    Examples
    --------
    >>> from scope_models import Detector, Motion, Star, simulate
    >>> stars = [Star(12.0), Star(14.5, x_0=8.0, y_0=3.0)]
    >>> observation = simulate(stars, Detector.k2(), Motion.k2_roll(100), seed=7)
    >>> observation.flux.shape
    (100, 11, 11)
    """
    if not isinstance(stars, Scene):
        scene = Scene(stars, detector, motion, **options)
    elif detector is not None or motion is not None:
        raise TypeError("a Scene holds detector and motion: `Scene.replace` changes them")
    else:
        scene = stars.replace(**options) if options else stars
    scene = scene.replace(seed=_noise.fresh_seed()) if scene.seed is None else scene
    if chunk_size is not None:
        chunk_size = checked_integer("chunk_size", chunk_size, 1)
    _check_memory(scene)
    prepared = _light.prepare(scene)
    rows = _light.shown(prepared.lights, prepared.positions.tolist())
    lost = [light.series.lost(x + scene.motion.x, y + scene.motion.y) for light, (x, y) in rows]
    x_0, y_0 = prepared.positions[0]
    # That of neighbors may fall off the stamp.
    star = f"the star at x_0 = {x_0:g}, y_0 = {y_0:g}"
    _warn_of_loss(f"{star} loses {{}} of its light", lost[0], scene.detector.shape)
    shape = (len(scene.motion), *scene.detector.shape)
    images, in_aperture = (np.zeros((len(scene.stars), *n)) for n in (shape[1:], shape[:1]))
    cubes = {name: np.empty(shape, np.float32) for name in ("flux", "flux_err")}
    cubes["raw_cnts"] = np.empty(shape, np.int32)
    model = np.empty(shape) if keep_model else None
    streams = {term: _noise.stream(scene.seed, term) for term in scene.noise}
    photons, of_sky = streams.get("photon"), streams.get("background")
    spilled, flux_bkg = 0.0, None
    with one_thread, _in_range():
        aperture = _choose_aperture(prepared)
        for part in _light.pieces(scene, chunk_size):
            expected = _light.gather(prepared, part, (images, in_aperture), aperture)
            added, subtracted = _light.pedestal(prepared, part, expected)
            sky = _noise.poisson_counts(added, of_sky, expected.shape) if of_sky else added
            # Without noise one array is both, and is filled once.
            charge = expected
            if photons or of_sky:
                charge = _noise.poisson_counts(expected, photons) if photons else expected.copy()
                _light.fill_wells(scene, charge, sky)
            spilled = max(spilled, _light.fill_wells(scene, expected, added))
            if keep_model:
                np.divide(expected, scene.detector.exposure_time, out=model[part])
            charge += sky
            background = (subtracted / scene.detector.exposure_time).astype(np.float32)
            if background.ndim == 2:
                flux_bkg = background
            else:
                flux_bkg = np.empty(shape, np.float32) if flux_bkg is None else flux_bkg
                flux_bkg[part] = background
            piece = {name: cube[part] for name, cube in cubes.items()}
            _record(prepared, part, (expected, charge), (added, subtracted), streams, piece)
    flux_bkg.flags.writeable = False  # then it is not copied
    _warn_of_loss(
        "{} of the charge of a cadence bleeds along full columns", spilled, scene.detector.shape
    )
    return Observation(
        **cubes, flux_bkg=np.broadcast_to(flux_bkg, shape), scene=scene,
        quality=_flag(prepared, cubes),
        truth=_truth(prepared, lost, _light.share_of_target(in_aperture), model), aperture=aperture,
        star_images=images * prepared.interpixel / len(scene.motion),
    )  # fmt: skip


def _check_memory(scene):
    """Refuse a scene whose pixels alone are more than the memory of the machine."""
    if "SC_PHYS_PAGES" not in getattr(os, "sysconf_names", ()):  # Windows
        return
    shape = len(scene.motion), *scene.detector.shape
    # The result, and the smallest piece of work without noise; see `_light.pieces`.
    needed = math.prod(shape[1:]) * (12 * shape[0] + 30 * _light.pieces(scene, 1)[0].stop)
    there = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    if 0 < there < needed:
        sizes = f"{needed / 1e9:,.0f} GB of memory, and the machine has {there / 1e9:,.0f} GB"
        raise ValueError(f"pixels of the shape {shape} need {sizes}: give a smaller `shape`")


@contextmanager
def _in_range():
    """Raise charge that overflows as an error of the scene."""
    try:
        with np.errstate(over="raise"):
            yield
    except FloatingPointError as error:
        raise ValueError(
            "the charge of a pixel is beyond single precision, 3.4e38: a star, the background or "
            f"an effect is too bright ({error})"
        ) from error


def _choose_aperture(prepared):
    """Return the pixels of the highest signal-to-noise ratio of the target, with its bleeding."""
    detector, n = prepared.scene.detector, len(prepared.scene.motion)
    some = slice(None, None, -(-n // _APERTURE_CADENCES))
    target, stars = np.zeros((2, len(range(*some.indices(n))), *detector.shape))
    for number, (light,) in enumerate(_light.shown(prepared.lights)):
        images = light.images(some)
        stars[:, *light.window] += images
        if number == 0:
            target[:, *light.window] = images
    background = (detector.background * prepared.interpixel).astype(np.float32)
    for images in (target, stars):
        np.multiply(images, prepared.interpixel * detector.exposure_time, out=images)
        _light.fill_wells(prepared.scene, images, background * detector.exposure_time)
    signal, flux = (images.mean(axis=0) / detector.exposure_time for images in (target, stars))
    if not signal.any():
        return np.ones(detector.shape, dtype=bool)
    numbers = detector.exposure_time, detector.read_noise, detector.n_reads
    return grown_aperture(signal, flux + background, *numbers)


def _record(prepared, part, charges, pedestals, streams, cubes):
    """Write what a slice of cadences records of expected and detected charge into its cubes."""
    detector, (added, subtracted) = prepared.scene.detector, pedestals
    expected, electrons = charges
    for stage in ("charge", "readout"):
        for effect, drawn in prepared.effects:
            getattr(effect, stage)(drawn, prepared.conditions, part, electrons)
    if "read" in streams:
        electrons += detector.cadence_read_noise * streams["read"].standard_normal(electrons.shape)
    if "quantization" in streams:
        _noise.add_quantization(electrons, detector.gain, detector.n_reads, streams["quantization"])
    counts = np.rint(electrons * (1.0 / detector.gain) + detector.fixed_offset)
    cubes["raw_cnts"][...] = np.clip(counts, 0, _LARGEST_COUNT)
    for effect, drawn in reversed(prepared.effects):
        effect.calibrate(drawn, prepared.conditions, part, electrons)
    per_second = 1.0 / detector.exposure_time
    cubes["flux"][...] = (electrons - subtracted) * per_second
    variances = {
        "background": added,
        "read": detector.cadence_read_noise**2,
        "quantization": detector.n_reads * detector.gain**2 / 12.0,
        "photon": expected,
    }
    variance = sum(value for term, value in variances.items() if term in prepared.scene.noise)
    error = np.maximum(np.sqrt(variance) * per_second, _ROUNDING).astype(np.float32)
    cubes["flux_err"][...] = np.maximum(error, _ROUNDING * np.abs(cubes["flux"]))


def _flag(prepared, cubes):
    """Return the quality flags, and take away the pixels of cadences without data."""
    quality = prepared.scene.motion.quality.copy()
    for flags in _light.results_of(prepared.effects, "quality", prepared.conditions):
        quality |= np.asarray(flags, dtype=quality.dtype)
    for missing in _light.results_of(prepared.effects, "missing", prepared.conditions):
        cubes["flux"][missing] = cubes["flux_err"][missing] = np.nan
        cubes["raw_cnts"][missing] = -1
    return quality


def _truth(prepared, lost, share, model):
    scene, lights = prepared.scene, prepared.lights
    columns = {"CADENCENO": scene.motion.cadenceno}
    columns |= scene_columns(scene, [light.relative_flux for light in lights])
    columns["TARGET_SHARE"] = share
    for i, light in enumerate(lights, start=1):
        columns |= {f"X{i}": light.x @ light.weights, f"Y{i}": light.y @ light.weights}
    maps, tables = {"INTERPIXEL": prepared.interpixel}, {}
    for _, drawn in prepared.effects:
        lists = {name: Table(dict(table)) for name, table in drawn.tables.items()}
        for found, into in ((drawn.columns, columns), (drawn.maps, maps), (lists, tables)):
            for name, value in found.items():  # with a number after one of its kind
                names = chain([name], (f"{name}_{number}" for number in count(2)))
                into[next(each for each in names if each not in into)] = value
    described = describe_scene(scene)
    described["found"] = {"flux": [light.flux for light in lights], "lost_fraction": lost}
    if model is not None:
        model.flags.writeable = False
    return Truth(columns, maps, described, tables, model)


def _warn_of_loss(text, fraction, shape):
    if fraction > _LARGEST_LOSS:
        lost = text.format(f"up to {100 * fraction:.1f} %")
        message = f"{lost} off the stamp of {shape[0]} x {shape[1]} pixels"
        warnings.warn(message, LostLightWarning, stacklevel=3)
