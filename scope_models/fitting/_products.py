"""The file of a fit, the twin of its star, and shapes with errors to first order."""

import json

import numpy as np
from astropy.stats import mad_std
from astropy.table import Table
from scipy.ndimage import median_filter, uniform_filter1d
from scipy.optimize import least_squares

from scope_models._arrays import native
from scope_models._checks import checked_choice
from scope_models.effects import Background, Focus, PixelShares
from scope_models.fitting import _parameters
from scope_models.io._opening import RefusedError, making, open_fits
from scope_models.io.tpf import write_hdulist
from scope_models.missions import MISSIONS
from scope_models.models import PRF, BivariateGaussianPSF, SensitivityPolynomial
from scope_models.models._description import describe_model, make_model, packed, unpacked
from scope_models.models._parameters import numbers_of
from scope_models.scene._files import describe_detector, make_detector
from scope_models.scene.motion import Motion, offsets_at
from scope_models.scene.scene import Scene, Star

__all__ = [
    "SMOOTHING_DAYS", "make_scene", "psf_shape", "read_fit", "sensitivity_profiles", "smoothed",
    "with_slopes", "write_fit",
]  # fmt: skip

_CREATOR, _VERSION = "scope_models fit", 2
_IMAGES = ("covariance", "interpixel", "interpixel_err", "observed", "observed_err", "fitted")
# Two periods of the roll of K2: what is faster is the pixels', not the star's.
SMOOTHING_DAYS = 0.5
# Pixels fainter than this part of the brightest one give the noise without light.
_FAINT = 0.05
_FEWEST_CADENCES = 20
# Bands of frequency in which power is compared with that of the noise.
_BANDS = 40
# Step of a derivative in errors of the parameter, and at most.
_STEP, _LARGEST_STEP = 0.05, 1e-3
# Pixels from the center to which the contour may reach; directions and radii in which it is sought.
_REACH, _DIRECTIONS, _RADII = 8.0, 90, 801
# Part of all light that any pixel may hold besides the image of a Gaussian.
_EVERYWHERE = 0.003


def write_fit(fit, path, *, overwrite):
    from astropy.io import fits

    primary = fits.PrimaryHDU()
    primary.header["CREATOR"] = _CREATOR
    primary.header["FITVERS"] = (_VERSION, "version of this format")
    columns = []
    for column in fit.cadences.itercols():
        unit = {"": None, "electron / s": "e-/s"}  # FITS has no electron
        unit = unit.get(text := str(column.unit or ""), text)
        kind = {"i": "K", "u": "K", "b": "L"}.get(column.dtype.kind, "D")
        for number, part in enumerate(np.atleast_2d(column.T), start=1):
            name = f"{column.name.upper()}{number if column.ndim > 1 else ''}"
            columns.append(fits.Column(name, kind, unit=unit, array=np.asarray(part)))
    neighbors = np.array([list(vars(star).values()) for star in fit.neighbors], dtype=float)
    text = np.frombuffer(json.dumps(_description(fit)).encode(), dtype=np.uint8)
    hdus = [
        primary,
        fits.BinTableHDU.from_columns(columns, name="CADENCES"),
        fits.BinTableHDU(fit.parameters, name="PARAMETERS"),
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
            raise RefusedError(f"{path} is not a fit of this package")
        if header.get("FITVERS", _VERSION + 1) > _VERSION:
            raise RefusedError(f"{path} was written by a later version of this package")
        with making(path, "fit"):
            return _fields_of(hdus)


def _fields_of(hdus):
    table = hdus["CADENCES"].data
    names = [name for name in _parameters.CADENCE_UNITS if name.upper() in table.names]
    columns = {name: native(table[name.upper()]) for name in names}
    if "POS_CORR1" in table.names:
        columns["pos_corr"] = np.column_stack([native(table[f"POS_CORR{i}"]) for i in (1, 2)])
    values = {name: native(hdus[name.upper()].data) for name in _IMAGES}
    cube = native(hdus["NEIGHBORS"].data) if "NEIGHBORS" in hdus else ()
    described = json.loads(native(hdus["DESCRIPTION"].data).astype(np.uint8).tobytes())
    prf, detector = described["model"], described["detector"]
    psf, sensitivity = make_model(prf["psf"]), make_model(prf["sensitivity"])
    bounds = {name: tuple(pair) for name, pair in prf["bounds"].items()}
    compound = psf if sensitivity is None else psf * sensitivity
    model = PRF(compound, **prf["values"], fixed=prf["fixed"], bounds=bounds)
    detector |= {"sensitivity": prf["sensitivity"], "psf": None, "interpixel": True}
    maps = {"INTERPIXEL": np.maximum(values["interpixel"], 0.0)}
    shares = ({name: unpacked(v) for name, v in one.items()} for one in described["response"])
    response = tuple(PixelShares(**values) for values in shares)
    statistics = {name: described.get(name, np.nan) for name in _parameters.STATISTICS}
    if described["options"]["interpixel"] is None:
        described["options"]["interpixel"] = np.inf
    free = [*map(_parameters.FitParameter, described["names"], described["kinds"])]
    parameters = _parameters.parameter_table(
        model, free, described["parameters"], values["covariance"], described["at_bounds"],
        statistics, response=bool(response),
    )  # fmt: skip
    kept = {name: described[name] for name in ("options", "time_format", "meta")}
    return values | kept | {
        "model": model, "parameters": parameters, "cadences": _parameters.cadence_table(columns),
        "neighbors": tuple(_parameters.FittedStar(*star) for star in cube), "response": response,
        "detector": make_detector(detector, maps), "statistics": statistics,
    }  # fmt: skip


def _description(fit):
    """Values that are neither an array by cadence nor an image."""
    model, options = fit.model, dict(fit.options)
    if not np.isfinite(options["interpixel"]):
        options["interpixel"] = None
    return {
        "model": {
            "psf": describe_model(model.psf),
            "sensitivity": describe_model(model.sensitivity),
            "values": numbers_of(model),
            "fixed": {name: bool(fixed) for name, fixed in model.fixed.items()},
            "bounds": {name: list(bounds) for name, bounds in model.bounds.items()},
        },
        "detector": describe_detector(fit.detector.replace(sensitivity=None, psf=None)),
        "names": list(fit.names),
        "kinds": fit.parameters["kind"][: len(fit.names)].tolist(),
        "at_bounds": list(fit.at_bounds),
        "parameters": list(fit.values.values()),
        "options": options,
        "meta": dict(fit.meta),
        "response": [{n: packed(v) for n, v in vars(shares).items()} for shares in fit.response],
        "time_format": fit.time_format,
        **fit.statistics,
    }


def make_scene(fit, positions, signal):
    common, path = isinstance(positions, Motion), fit.pos_corr
    if not common:
        checked_choice("positions", positions, ("fitted", "path"))
    checked_choice("signal", signal, ("smooth", "fitted", "constant"))
    xy = np.column_stack([fit.x, fit.y])
    if fit.response and path is not None:
        errors = fit.x_err, fit.y_err
        parts = zip(path.T, xy.T, errors, strict=True)
        xy = np.column_stack([p + denoised(fit, place - p, error) for p, place, error in parts])
    if common:
        path, _ = offsets_at(positions, fit.time, fit.time_format, fit.meta, fit.shape)
    if common or positions == "path":
        if path is None:
            raise ValueError("`positions` is 'path', but the file had no POS_CORR")
        known = np.isfinite(path).all(axis=1)
        basis = np.column_stack([np.ones(known.sum()), path[known]])
        xy[known] = basis @ np.linalg.lstsq(basis, xy[known], rcond=None)[0]
    flux = float(np.median(fit.flux))
    if flux <= 0:
        raise ValueError(f"the star has no flux to simulate: its median is {flux:g} e-/s")
    detector = fit.detector.replace(read_noise=_read_noise(fit))
    middle, stars = np.median(xy, axis=0).tolist(), []
    for star in (fit, *fit.neighbors):
        *place, light = (float(np.median(values)) for values in (star.x, star.y, star.flux))
        if light > 0:
            mag = detector.zero_point_mag - 2.5 * np.log10(light / detector.zero_point)
            own = {} if stars else {"signal": _signal(fit, signal)}
            stars.append(Star(float(mag), *(place if stars else middle), psf=fit.psf, **own))
    arrays = {name: getattr(fit, name) for name in ("time", "quality", "cadenceno", "time_format")}
    motion = Motion(x=xy[:, 0] - middle[0], y=xy[:, 1] - middle[1], **arrays)
    effects = () if np.all(fit.focus == 1) else (Focus(series=fit.focus),)
    if fit.response:
        left = denoised(fit, fit.background, fit.background_err)
        effects += (*fit.response, Background(left=left))
    return Scene(stars, detector, motion, effects=effects, **_identity(fit.meta, detector.mission))


def _identity(cards, mission):
    """Return the fields of a scene that identify the target, of the cards that the file had."""
    names = {"object_name": "OBJECT", "ra": "RA_OBJ", "dec": "DEC_OBJ"}
    names |= {"column": "1CRV5P", "row": "2CRV5P"}
    names["target_id"] = "KEPLERID" if "KEPLERID" in cards else "TICID"
    found = {name: cards[key] for name, key in names.items() if key in cards}
    steps = [cards.get(key) for key in ("1CDLT5", "12PC5", "2CDLT5", "22PC5")]
    if all(isinstance(step, int | float) for step in steps):
        east, north = steps[0] * steps[1], steps[2] * steps[3]
        found["orientation"] = float(np.degrees(np.arctan2(east, north)))
    if mission in MISSIONS:
        names = (MISSIONS[mission].run, *MISSIONS[mission].places)
        found["metadata"] = {n: cards[n.upper()] for n in names if n.upper() in cards}
    return found


def _signal(fit, kind):
    if kind == "constant":
        return None
    typical = np.median(fit.flux)
    relative = fit.flux / typical
    if kind == "smooth" and fit.response:
        relative = denoised(fit, fit.flux, fit.flux_scatter) / typical
    elif kind == "smooth":
        # Sums of pixels: unlike fitted fluxes they do not depend on errors of the PSF.
        cubes = (cube - fit.background[:, None, None] for cube in (fit.observed, fit.fitted))
        light, expected = (np.nansum(cube, axis=(1, 2)) for cube in cubes)
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
    steps = np.diff(fit.residual, axis=0)
    seen = np.isfinite(steps).any(axis=0)
    flux = np.nanmedian(fit.fitted[:, seen], axis=0)
    scatter = mad_std(steps[:, seen], axis=0, ignore_nan=True) / 2**0.5
    light = np.maximum(flux + detector.background, 0.0) / detector.exposure_time
    variance = (scatter**2 - light)[flux < max(_FAINT * flux.max(), np.median(flux))]
    variance = np.median(variance) * detector.exposure_time**2 / detector.n_reads
    return float(np.sqrt(max(variance, 0.0)))


def sensitivity_profiles(fit):
    """Offsets and, by axis, fitted sensitivity and error, NaN at a bound; None without one."""
    model = fit.sensitivity
    if not isinstance(model, SensitivityPolynomial):
        return None
    offset = np.linspace(-0.5, 0.5, 51)
    profiles = {"offset": offset}
    for axis in "xy":
        powers = {name: offset**power for name, (of, power) in model.powers.items() if of == axis}
        value = sum(getattr(model, name).value * term for name, term in powers.items())
        terms = [powers.get(name, np.zeros_like(offset)) for name in fit.names]
        terms = np.reshape(terms, (-1, len(offset)))
        variance = np.einsum("iu,ij,ju->u", terms, fit.covariance, terms)
        known = all(fit.errors[name] > 0 for name in fit.names if name in powers)
        profiles[axis] = value, np.sqrt(np.maximum(variance, 0.0)) if known else variance * np.nan
    return profiles


def with_slopes(fit, measure):
    """Return a measure of the PSF, and its derivatives by the free parameters, ``(s, ...)``."""
    value = measure(fit.psf)
    slopes = np.zeros((len(fit.names), *value.shape))
    for slope, name in zip(slopes, fit.names, strict=True):
        if name in fit.model.param_names and fit.errors[name] > 0:
            model, step = fit.model.copy(), min(_STEP * fit.errors[name], _LARGEST_STEP)
            setattr(model, name, fit.values[name] + step)
            slope[:] = (measure(fit.replace(model=model).psf) - value) / step
    return value, slopes


def psf_shape(fit):
    if fit.response:
        moments, covariance = _moments_of_shares(fit)
    else:
        offset, density, _ = fit.psf_image(2.0, 81)
        row, column = np.unravel_index(np.argmax(density), density.shape)
        center = offset[column], offset[row]
        moments, slopes = with_slopes(fit, lambda psf: _moments(psf, *center))
        covariance = slopes.T @ fit.covariance @ slopes
    values = _axes(moments)
    # Small steps, for the axes of a circle have no direction.
    steps = np.minimum(_STEP * np.sqrt(np.diag(covariance)) + 1e-12, _LARGEST_STEP * moments[0])
    by = np.transpose([_axes(moments + step) - values for step in np.diag(steps)])
    by[-1] = (by[-1] + 90) % 180 - 90
    errors = np.sqrt(np.einsum("ai,ij,aj->a", by / steps, covariance, by / steps))
    names = ("fwhm", "fwhm_major", "fwhm_minor", "ellipticity", "angle")
    units = ("pix", "pix", "pix", "", "deg")
    table = Table({"name": names, "value": values, "error": errors, "unit": units})
    table["value"].info.format, table["error"].info.format = ".4g", ".2g"
    return table


def _moments_of_shares(fit):
    """Moments of the Gaussian that fits the typical shares, and their covariance."""
    x, y, time = (np.median(values) for values in (fit.x, fit.y, fit.time))
    shares = fit.model.unit_images(fit.shape, x, y) + fit.response[0].changes([x], [y], [time])[0]
    used = np.isfinite(fit.fitted).any(axis=0)
    # The pixels scatter about it by one part of their light, and of all light in faint ones.
    weight = used / (np.abs(shares) + _EVERYWHERE)
    gaussian = PRF(BivariateGaussianPSF())

    def residual(values):
        gaussian.parameters = values
        return (weight * (gaussian.unit_images(fit.shape) * values[0] - shares))[used]

    lower = [0.0, x - 2, y - 2, *[0.1] * 2, -0.95]
    upper = [2.0, x + 2, y + 2, *[10.0] * 2, 0.95]
    found = least_squares(residual, [1.0, x, y, 0.5, 0.5, 0.0], bounds=(lower, upper))
    sigma_x, sigma_y, rho = found.x[3:]
    # Mostly the bright pixels determine the Gaussian: their number, and how far they scatter.
    light = np.abs(shares)[used]
    number = light.sum() ** 2 / np.sum(light**2)
    variance = (light @ found.fun**2) / light.sum() * number / max(number - len(found.x), 1)
    covariance = variance * np.linalg.pinv(found.jac.T @ found.jac)[3:, 3:]
    # Of the area above half of the largest value, of a Gaussian.
    unit = np.log(4) / 4
    by = np.diag([2 * sigma_x, 2 * sigma_y, sigma_x * sigma_y])
    by[2, :2] = rho * sigma_y, rho * sigma_x
    moments = np.array([sigma_x**2, sigma_y**2, rho * sigma_x * sigma_y])
    return unit * moments, unit**2 * by @ covariance @ by.T


def _moments(psf, x, y):
    """Second moments xx, yy and xy of the area above half of the value in the center."""
    angle = np.arange(_DIRECTIONS) * (2 * np.pi / _DIRECTIONS)
    cos, sin = np.cos(angle), np.sin(angle)
    radii = np.linspace(0, _REACH, _RADII)
    density = np.asarray(psf(x + np.outer(radii, cos), y + np.outer(radii, sin)))
    above = density - density[0] / 2
    first = np.argmax(above < 0, axis=0)
    if not first.all():
        return np.full(3, np.nan)
    inner, outer = np.take_along_axis(above, np.stack([first - 1, first]), axis=0)
    r = radii[first] - radii[1] * outer / (outer - inner)
    area = np.mean(r**2) / 2
    mean = [np.mean(r**3 * part) / (3 * area) for part in (cos, sin)]
    squares = [np.mean(r**4 * part) / (4 * area) for part in (cos * cos, sin * sin, cos * sin)]
    return np.array(squares) - [mean[0] ** 2, mean[1] ** 2, mean[0] * mean[1]]


def _axes(moments):
    """Return the rows of the table for an ellipse with these second moments."""
    xx, yy, xy = moments
    half, turned = (xx + yy) / 2, np.hypot((xx - yy) / 2, xy)
    major, minor = 4 * np.sqrt(half + turned), 4 * np.sqrt(half - turned)
    angle = np.degrees(np.arctan2(2 * xy, xx - yy)) / 2
    return np.array([np.sqrt(major * minor), major, minor, 1 - minor / major, angle])
