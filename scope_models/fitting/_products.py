"""What is made of a fit: its file, the twin of the star, its sensitivity as a figure shows it."""

import json
from dataclasses import fields

import numpy as np
from scipy.ndimage import median_filter, uniform_filter1d

from scope_models._arrays import native
from scope_models._checks import checked_choice, one_line
from scope_models.effects import Background, Focus, PixelShares
from scope_models.fitting._parameters import (
    CADENCE_UNITS,
    STATISTICS,
    FitParameter,
    FittedStar,
    cadence_table,
    parameter_table,
)
from scope_models.io._opening import RefusedError, open_fits
from scope_models.io.tpf import write_hdulist
from scope_models.missions import MISSIONS
from scope_models.models import PRF, SensitivityPolynomial
from scope_models.models._description import describe_model, make_model, packed, unpacked
from scope_models.models._parameters import numbers_of
from scope_models.scene.detector import Detector
from scope_models.scene.motion import Motion
from scope_models.scene.scene import Scene
from scope_models.scene.star import Star

__all__ = [
    "SMOOTHING_DAYS",
    "make_scene",
    "read_fit",
    "sensitivity_profiles",
    "smoothed",
    "write_fit",
]

_CREATOR, _VERSION = "scope_models fit", 2
_OF_STAR = ("x", "y", "flux", "x_err", "y_err", "flux_err")
_IMAGES = ("covariance", "interpixel", "interpixel_err", "observed", "observed_err", "fitted")
# Two periods of the roll of K2: what is faster is the pixels', not the star's.
SMOOTHING_DAYS = 0.5
# Pixels fainter than this part of the brightest one give the noise without light.
_FAINT = 0.05
_FEWEST_CADENCES = 20
# Bands of frequency in which power is compared with that of the noise.
_BANDS = 40


def write_fit(fit, path, *, overwrite):
    """Write a fit; the file is there as a whole or not at all."""
    from astropy.io import fits

    primary = fits.PrimaryHDU()
    primary.header["CREATOR"] = _CREATOR
    primary.header["FITVERS"] = (_VERSION, "version of this format")
    columns = []
    for column in fit.cadences.itercols():
        name, unit = column.name.upper(), str(column.unit or "") or None
        kind = {"i": "K", "u": "K", "b": "L"}.get(column.dtype.kind, "D")
        parts = (
            {name: column} if column.ndim == 1 else {f"{name}{i + 1}": column[:, i] for i in (0, 1)}
        )
        columns += [fits.Column(n, kind, unit=unit, array=np.asarray(c)) for n, c in parts.items()]
    parameters = fits.BinTableHDU(fit.parameters, name="PARAMETERS")
    neighbors = np.array([[getattr(s, n) for n in _OF_STAR] for s in fit.neighbors], dtype=float)
    neighbors = neighbors.reshape(len(fit.neighbors), len(_OF_STAR), len(fit.time))
    text = np.frombuffer(json.dumps(_description(fit)).encode(), dtype=np.uint8)
    hdus = [
        primary,
        fits.BinTableHDU.from_columns(columns, name="CADENCES"),
        parameters,
        *(fits.ImageHDU(np.array(getattr(fit, name)), name=name.upper()) for name in _IMAGES),
        *([fits.ImageHDU(neighbors, name="NEIGHBORS")] if fit.neighbors else []),
        fits.ImageHDU(text, name="DESCRIPTION"),
    ]
    return write_hdulist(fits.HDUList(hdus), path, overwrite=overwrite)


def read_fit(path):
    """Return the fields of a fit that `write_fit` has written."""
    with open_fits(path) as hdus:
        header = hdus[0].header
        if header.get("CREATOR") != _CREATOR:
            raise RefusedError(f"{path} is no fit of this package")
        if header.get("FITVERS", _VERSION + 1) > _VERSION:
            raise RefusedError(f"{path} was written by a later version of this package")
        try:
            return _fields_of(hdus)
        except Exception as error:  # a file can hold anything under the names of a fit
            reason = one_line(error)
            raise RefusedError(
                f"{path} holds no fit that can be made: {type(error).__name__}: {reason}"
            ) from error


def _fields_of(hdus):
    """Return the fields of the fit in an HDU list."""
    table = hdus["CADENCES"].data
    columns = {"focus": np.ones(len(table))}  # the first version had none
    names = [name for name in CADENCE_UNITS if name.upper() in table.names]
    columns |= {name: native(table[name.upper()]) for name in names}
    if "POS_CORR1" in table.names:
        corrections = [native(table[f"POS_CORR{i}"]) for i in (1, 2)]
        columns["pos_corr"] = np.column_stack(corrections)
    values = {"cadences": cadence_table(columns)}
    values |= {name: native(hdus[name.upper()].data) for name in _IMAGES}
    cube = native(hdus["NEIGHBORS"].data) if "NEIGHBORS" in hdus else ()
    values["neighbors"] = tuple(FittedStar(*star) for star in cube)
    described = json.loads(native(hdus["DESCRIPTION"].data).astype(np.uint8).tobytes())
    model = _model(described.pop("model"))
    detector = described.pop("detector")
    detector["sensitivity"] = model.sensitivity
    detector["interpixel"] = np.maximum(values["interpixel"], 0.0)
    detector["shape"] = tuple(detector["shape"])
    described["response"] = tuple(
        PixelShares(**{name: unpacked(value) for name, value in shares.items()})
        for shares in described.get("response", ())
    )
    if described["options"]["interpixel"] is None:
        described["options"]["interpixel"] = np.inf
    names = described.pop("names")
    kinds = [model.parameter_kinds.get(name, "other") for name in names]
    kinds = described.pop("kinds", kinds)  # the first version had none
    statistics = {name: described.pop(name, np.nan) for name in STATISTICS}
    values["parameters"] = parameter_table(
        model,
        [FitParameter(*item) for item in zip(names, kinds, strict=True)],
        described.pop("parameters"),
        values["covariance"],
        described.pop("at_bounds", ()),
        statistics,
        response=bool(described["response"]),
    )
    values |= {"statistics": statistics, "model": model, "detector": Detector(**detector)}
    return described | values


def _description(fit):
    """Values that are neither an array by cadence nor an image."""
    model = fit.model
    detector = {
        item.name: getattr(fit.detector, item.name)
        for item in fields(fit.detector)
        if item.name not in {"sensitivity", "interpixel", "psf"}
    }
    names = model.param_names
    options = dict(fit.options)
    if not np.isfinite(options["interpixel"]):
        options["interpixel"] = None
    return {
        "model": {
            "psf": describe_model(model.psf),
            "sensitivity": describe_model(model.sensitivity),
            "values": numbers_of(model),
            "fixed": {n: bool(getattr(model, n).fixed) for n in names},
            "bounds": {n: list(getattr(model, n).bounds) for n in names},
        },
        "detector": detector,
        "names": list(fit.names),
        "kinds": fit.parameters["kind"][: len(fit.names)].tolist(),
        "at_bounds": list(fit.at_bounds),
        "parameters": list(fit.values.values()),
        "options": options,
        "meta": dict(fit.meta),
        "response": [
            {item.name: packed(getattr(shares, item.name)) for item in fields(shares)}
            for shares in fit.response
        ],
        "time_format": fit.time_format,
        **fit.statistics,
    }


def _model(described):
    """The PRF of a description."""
    psf, sensitivity = make_model(described["psf"]), make_model(described["sensitivity"])
    model = PRF(psf if sensitivity is None else psf * sensitivity)
    for name, value in described["values"].items():
        parameter = getattr(model, name)
        parameter.value = value
        parameter.fixed = described["fixed"][name]
        parameter.bounds = tuple(described["bounds"][name])
    return model


def make_scene(fit, positions, signal):
    """Return the scene of a fit."""
    checked_choice("positions", positions, ("fitted", "path"))
    checked_choice("signal", signal, ("smooth", "fitted", "constant"))
    x, y = fit.x, fit.y
    if fit.response and fit.pos_corr is not None:
        x, y = (
            path + denoised(fit, p - path, error)
            for p, path, error in zip((x, y), fit.pos_corr.T, (fit.x_err, fit.y_err), strict=True)
        )
    if positions == "path":
        if fit.pos_corr is None:
            raise ValueError("`positions` is 'path', but the file had no POS_CORR")
        basis = np.column_stack([np.ones(len(x)), fit.pos_corr])
        x, y = (basis @ np.linalg.lstsq(basis, p, rcond=None)[0] for p in (x, y))
    middle = float(np.median(x)), float(np.median(y))
    flux = float(np.median(fit.flux))
    if flux <= 0:
        raise ValueError(f"the star has no flux to simulate: its median is {flux:g} e-/s")
    detector = fit.detector.replace(read_noise=_read_noise(fit))
    stars = []
    for star in (fit, *fit.neighbors):
        *place, light = (float(np.median(values)) for values in (star.x, star.y, star.flux))
        if light > 0:
            mag = detector.zero_point_mag - 2.5 * np.log10(light / detector.zero_point)
            own = {} if stars else {"signal": _signal(fit, signal)}
            stars.append(Star(float(mag), *(place if stars else middle), psf=fit.psf, **own))
    motion = Motion(
        time=fit.time,
        x=x - middle[0],
        y=y - middle[1],
        quality=fit.quality,
        cadenceno=fit.cadenceno,
        time_format=fit.time_format,
    )
    effects = () if np.all(fit.focus == 1) else (Focus(series=fit.focus),)
    if fit.response:
        left = denoised(fit, fit.background, fit.background_err)
        effects += (*fit.response, Background(left=left))
    identity = _identity(fit.meta, detector.mission)
    return Scene(stars, detector, motion, effects=effects, **identity)


def _identity(cards, mission):
    """Return the fields of a scene that identify the target, of the cards that the file had."""
    names = {"target_id": ("KEPLERID", "TICID"), "object_name": ("OBJECT",)}
    names |= {"ra": ("RA_OBJ",), "dec": ("DEC_OBJ",), "column": ("1CRV5P",), "row": ("2CRV5P",)}
    found = {
        name: next((cards[key] for key in keys if key in cards), None)
        for name, keys in names.items()
    }
    steps = [cards.get(key) for key in ("1CDLT5", "12PC5", "2CDLT5", "22PC5")]
    if all(isinstance(step, int | float) for step in steps):
        east, north = steps[0] * steps[1], steps[2] * steps[3]
        found["orientation"] = float(np.degrees(np.arctan2(east, north)))
    if mission in MISSIONS:
        names = (MISSIONS[mission].run, *MISSIONS[mission].places)
        found["metadata"] = {n: cards[n.upper()] for n in names if n.upper() in cards}
    return {name: value for name, value in found.items() if value is not None}


def _signal(fit, kind):
    """Relative flux of the cadences."""
    if kind == "constant":
        return None
    relative = fit.flux / np.median(fit.flux)
    if kind == "smooth" and fit.response:
        relative = denoised(fit, fit.flux, fit.flux_scatter) / np.median(fit.flux)
    elif kind == "smooth":
        # Sums of pixels: unlike fitted fluxes they do not depend on errors of the PSF.
        background = fit.background[:, None, None]
        light = np.nansum(fit.observed - background, axis=(1, 2))
        expected = np.nansum(fit.fitted - background, axis=(1, 2))
        ratio = np.divide(light, expected, out=np.ones_like(light), where=expected > 0)
        relative = smoothed(fit.time, relative * ratio)
        relative /= np.median(relative)
    return np.maximum(relative, 0.0)


def smoothed(time, values):
    """Running mean of a running median."""
    step = np.median(np.diff(time)) if len(time) > 1 else 1.0
    size = min(2 * round(SMOOTHING_DAYS / step / 2) + 1, 2 * (len(values) // 2) + 1)
    values = median_filter(values, size, mode="nearest")
    return uniform_filter1d(values, size, mode="nearest")


def denoised(fit, values, error):
    """Values ``(n,)`` with their variations scaled down to the power that errors do not explain."""
    slow, out = smoothed(fit.time, values), fit.outliers
    fast = np.where(out, 0.0, values - slow)
    spectrum = np.fft.rfft(fast)
    power = uniform_filter1d(np.abs(spectrum) ** 2, max(len(spectrum) // _BANDS, 3))
    # The pixels scatter by more than their errors.
    noise = np.sum(np.where(out, 0.0, error) ** 2) * max(fit.reduced_chi2, 1.0)
    part = np.clip(1 - noise / np.maximum(power, 1e-300), 0.0, 1.0)
    return slow + np.fft.irfft(np.sqrt(part) * spectrum, len(fast))


def _read_noise(fit):
    """Noise per read with which the faint pixels of a simulation scatter as those of the file."""
    detector = fit.detector
    if len(fit.time) < _FEWEST_CADENCES:
        return detector.read_noise
    seconds = detector.exposure_time
    with np.errstate(invalid="ignore"):
        steps = np.abs(np.diff(fit.residual, axis=0)) / 2**0.5
        seen = np.isfinite(steps).any(axis=0)
        flux = np.nanmedian(np.where(seen, fit.fitted, 0.0), axis=0)
        scatter = 1.4826 * np.nanmedian(np.where(seen, steps, 0.0), axis=0) * seconds
    faint = seen & (flux < max(_FAINT * flux.max(), np.median(flux[seen])))
    light = np.maximum(flux + detector.background, 0.0) * seconds
    variance = np.median((scatter**2 - light)[faint]) / detector.n_reads
    return float(np.sqrt(max(variance, 0.0)))


def sensitivity_profiles(fit):
    """The fitted sensitivity along both axes, with its uncertainty, or None if it is no polynomial.

    "offset" and, by axis, value and standard deviation, all of the same shape; NaN where a
    coefficient is at its bound.
    """
    model = fit.sensitivity
    if not isinstance(model, SensitivityPolynomial):
        return None
    offset = np.linspace(-0.5, 0.5, 51)
    profiles = {"offset": offset}
    for axis in "xy":
        names = [name for name, place in model.powers.items() if place[0] == axis]
        value = np.polynomial.polynomial.polyval(offset, [getattr(model, n).value for n in names])
        free = [name for name in names if name in fit.names]
        index = [fit.names.index(name) for name in free]
        powers = np.array([offset ** model.powers[name][1] for name in free]).reshape(len(free), -1)
        block = fit.covariance[np.ix_(index, index)]
        variance = np.einsum("iu,ij,ju->u", powers, block, powers)
        known = all(fit.errors[name] > 0 for name in free)
        profiles[axis] = value, np.sqrt(np.maximum(variance, 0.0)) if known else variance * np.nan
    return profiles
