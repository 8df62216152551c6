"""Adds signals and stars to the pixels of target pixel files, real or simulated."""

import warnings
from numbers import Real

import numpy as np
from astropy.io import fits

from scope_models._checks import on_stamp
from scope_models.exceptions import LostLightWarning
from scope_models.io import read_pixels, read_tpf
from scope_models.scene import Detector, Motion, Scene, Star, read_scene
from scope_models.simulation.simulate import simulate

__all__ = ["inject"]


def inject(tpf, signal=None, star=None, *, seed=None, noise=True):
    """Add a signal to the light of a star in a target pixel file, or add a whole star.

    The expected light changes by ``(signal - 1)`` times the star's own light, and photon noise with
    it; where FLUX_ERR has no positive number, only that of added light is known. RAW_CNTS stay.

    Parameters
    ----------
    tpf : lightkurve.TargetPixelFile, str or path-like
        The target pixel file, which is not changed.
    signal : astropy.modeling.Model or callable or array_like, optional
        Relative flux: a function of time (days, as in the file) as `~scope_models.TransitModel`,
        or one number for each cadence. Without it, ``star`` is added as a whole.
    star : Scene, TPFFit, Star or float, optional
        The light that the signal multiplies: the first star of a scene or of the ``scene()`` of a
        fit; a star on the pixels of the file, with its motion; or its share in the light of all
        pixels, between 0 and 1. The default is the scene in a simulated file. Without a signal, a
        star that is not yet in the file.
    seed : int, optional
        Seed of the photon noise.
    noise : bool, optional
        Whether photon noise changes.

    Returns
    -------
    lightkurve.TargetPixelFile
        A new object of the same class. Its table INJECTED has the signal and FLUX_ADDED, the
        expected change of the flux of each pixel, cadence by cadence. The scene and the truth of a
        simulated file have the change if its own light changes or a star is added.

    Raises
    ------
    TypeError
        If an argument is of the wrong kind, or both ``signal`` and ``star`` are missing.
    OSError, ValueError
        If the file cannot be read; if the signal is negative, not finite or of another length; if
        the star is outside the stamp, or the scene has another shape.

    Notes
    -----
    A star of variance :math:`V` per pixel that loses :math:`L` (both in (e-/s)^2) of it keeps the
    part :math:`1 - L/V` of its residuals, and normal noise of variance :math:`L - L^2/V` is added,
    which leaves :math:`V - L`, as in a binomial thinning of the photons.

    Examples
    --------
    >>> from scope_models import Detector, Motion, Star, TransitModel, inject, simulate
    >>> tpf = simulate(Star(12.0), Detector.k2(), Motion.k2_roll(200), seed=1).to_tpf()
    >>> planet = TransitModel.from_depth_duration(0.01, duration=0.2, period=2.0, t0=2344.5)
    >>> injected = inject(tpf, planet, seed=2)
    >>> print((injected.flux.sum() / tpf.flux.sum()).round(4))
    0.9992
    """
    if not isinstance(noise, bool | np.bool_):
        raise TypeError(f"`noise` must be True or False, got {noise!r}")
    original = read_tpf(tpf)
    hdus = fits.HDUList([hdu.copy() for hdu in original.hdu])
    whole = read_pixels(hdus, quality_bitmask="none")
    rows = np.flatnonzero(np.isfinite(whole.time))
    series = whole[rows]
    known = series.flux_err > 0
    error = np.where(known, series.flux_err, 0.0)
    exposure = Detector.from_tpf(series).exposure_time
    if signal is None:
        if not isinstance(star, Star):
            raise TypeError(f"`star` must be a Star if there is no `signal`, got {star!r}")
        relative, kept, residual = np.ones(len(series)), 1.0, 0.0
        change, after = _added(star, original, series)
    else:
        relative = _relative_flux(signal, original, whole)[rows]
        given = star, relative, original, series, error**2 * exposure
        change, kept, residual, after = _multiplied(*given)
    table = hdus[1].data
    flux = series.flux + change
    if noise:
        # What is left of the residuals has a part of the variance; new noise adds the rest.
        wanted, stays = error**2 + change / exposure, kept**2 * error**2
        missing = np.maximum(wanted - stays, 0.0)
        drawn = np.sqrt(missing) * np.random.default_rng(seed).standard_normal(missing.shape)
        flux = flux + (drawn + (kept - 1) * residual)
        error = np.sqrt(np.maximum(wanted, stays))
        table["FLUX_ERR"][rows] = np.where(known, error, series.flux_err)
    table["FLUX"][rows] = flux
    hdus[1].header.remove("CHECKSUM", ignore_missing=True)
    hdus[1].header.remove("DATASUM", ignore_missing=True)
    if after is not None:
        new = after.to_tpf(aperture_mask=series.aperture, quality_bitmask="none").hdu
        for hdu in new[new.index_of("TRUTH") :]:
            hdus[hdu.name] = hdu
    added = np.where(np.isfinite(series.flux), change, 0.0)
    _record(hdus, series, relative, added, star if signal is None else None)
    return type(original)(hdus, quality_bitmask=original.quality_bitmask)


def _relative_flux(signal, tpf, series):
    """Return the signal in all rows of the table, 1 where the object has no cadence."""
    relative = np.ones(len(series))
    used = np.flatnonzero(np.isfinite(series.time))
    if not callable(signal) and np.ndim(signal) == 1 and len(signal) == len(tpf.flux):
        used = np.flatnonzero(tpf.quality_mask)
    relative[used] = Star(0.0, signal=signal).relative_flux(series.time[used])
    return relative


def _added(star, tpf, series):
    """Return the light of a star that is not in the file, and the simulation of both or None."""
    if "SCENE" not in tpf.hdu:
        return _simulated(_scene_of(star, series)).truth.model, None
    scene = _scene_of(None, series, tpf)
    after = _simulated(_on_stamp(scene.replace(stars=[*scene.stars, star])))
    return after.truth.model - _simulated(scene).truth.model, after


def _multiplied(star, relative, tpf, series, electrons):
    """Return the change of a star's light, where ``electrons`` are the variance.

    Further: the factor on the residuals, those that do not have it yet, and the simulation of the
    changed scene, or None.
    """
    if isinstance(star, Real) and not isinstance(star, bool):
        if not 0 <= star <= 1:
            raise ValueError(f"`star` must be a share between 0 and 1, got {star}")
        factor = float(star) * (relative - 1)[:, np.newaxis, np.newaxis]
        return factor * series.flux, 1 + factor, 0.0, None
    scene = _scene_of(star, series, tpf)
    target = scene.stars[0]
    now = target.relative_flux(scene.motion.time)
    unchanged = _simulated(scene.replace(noise=False))
    changed = target.replace(signal=now * relative)
    after = _simulated(scene.replace(stars=(changed, *scene.stars[1:])))
    expected = after.truth.model - unchanged.truth.model
    if isinstance(star, Star):
        # the residuals would hold the light of stars that the model of one star does not have
        return expected, 1.0, 0.0, None
    lost = np.minimum(np.maximum(-expected, 0.0), electrons)
    kept = 1 - np.divide(lost, electrons, out=np.zeros_like(lost), where=electrons > 0)
    # the flux, not the model, has the background that is left in the file
    return expected, kept, series.flux - unchanged.flux, after if star is None else None


def _scene_of(star, series, tpf=None):
    """Return the scene of a star, on the cadences of the series."""
    if isinstance(star, Star):
        known = series.pos_corr is not None and np.isfinite(series.pos_corr).any()
        places = series.pos_corr.T if known else np.zeros((2, len(series)))
        motion = Motion.from_arrays(series.time, *places, time_format=series.time_format)
        scene = _on_stamp(Scene(star, Detector.from_tpf(series), motion, seed=0))
    elif star is None:
        if "SCENE" not in tpf.hdu:
            raise ValueError("`star` must be given: the file holds no scene with its light")
        scene = read_scene(tpf)
    else:
        scene = star.scene() if callable(getattr(star, "scene", None)) else star
    if not isinstance(scene, Scene):
        raise TypeError(f"`star` must be a Scene, a fit, a Star or a share, got {star!r}")
    ours, theirs = scene.detector.shape, series.flux.shape[1:]
    if ours != theirs:
        raise ValueError(f"the scene of `star` has {ours} pixels, the file {theirs}")
    return _at(scene, series)


def _on_stamp(scene):
    (x_0, y_0), (ny, nx) = scene.positions[-1], scene.detector.shape
    if not on_stamp((x_0, y_0), (ny, nx)):
        place = f"column {x_0:g} and row {y_0:g} of {nx} and {ny}"
        raise ValueError(f"`star` is outside the stamp: {place}")
    return scene


def _at(scene, series):
    """Return a scene on the cadences of the series, interpolated if they are others."""
    scene = scene.replace(seed=scene.seed or 0)
    motion, time = scene.motion, series.time
    if len(motion) == len(time) and np.array_equal(motion.time, time):
        return scene

    def at(values):
        return np.interp(time, motion.time, values)

    stars = [star.replace(signal=at(star.relative_flux(motion.time))) for star in scene.stars]
    moved = Motion.from_arrays(time, at(motion.x), at(motion.y), time_format=motion.time_format)
    detector = scene.detector
    detector = detector.replace(effects=[e.at(motion.time, time) for e in detector.effects])
    effects = [effect.at(motion.time, time) for effect in scene.effects]
    return scene.replace(stars=stars, detector=detector, motion=moved, effects=effects)


def _simulated(scene):
    with warnings.catch_warnings(action="ignore", category=LostLightWarning):
        return simulate(scene, keep_model=True)


def _record(hdus, series, relative, added, star):
    ny, nx = series.flux.shape[1:]
    name, number = "INJECTED", 1 + sum(hdu.name == "INJECTED" for hdu in hdus)
    columns = [
        fits.Column("CADENCENO", "J", array=series.cadenceno),
        fits.Column("TIME", "D", "d", array=series.time),
        fits.Column("SIGNAL", "D", array=relative),
        fits.Column("FLUX_ADDED", f"{ny * nx}E", "e-/s", dim=f"({nx},{ny})", array=added),
    ]
    table = fits.BinTableHDU.from_columns(columns, name=name, ver=number)
    table.header["KIND"] = ("signal" if star is None else "star", "what was injected")
    if star is not None:
        table.header["MAG"] = (star.mag, "magnitude of the star")
    hdus.append(table)
    hdus[0].header[name] = (number, "times that light was injected")
    hdus[0].header.set("NEXTEND", len(hdus) - 1)
