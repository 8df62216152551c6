"""Tables and the file of a fit, the twin of its star, shapes with errors to first order."""

import json
from dataclasses import dataclass

import numpy as np
from astropy.stats import mad_std
from astropy.table import Table
from scipy.ndimage import median_filter, uniform_filter1d
from scipy.optimize import least_squares
from scipy.stats import f as f_distribution

from scope_models._arrays import native
from scope_models._checks import checked_choice
from scope_models._values import Value
from scope_models.effects import Background, Focus, PixelShares
from scope_models.io._opening import RefusedError, making, open_fits
from scope_models.io.tpf import write_hdulist
from scope_models.missions import MISSIONS
from scope_models.models import PRF, BivariateGaussianPSF, SensitivityPolynomial
from scope_models.models._description import describe_model, make_model, packed, unpacked
from scope_models.models.integration import numbers_of
from scope_models.scene._files import describe_detector, make_detector
from scope_models.scene.motion import Motion, offsets_at
from scope_models.scene.scene import Scene, Star

__all__ = [
    "CADENCE_UNITS", "STATISTICS", "FittedStar", "cadence_table", "degrees_of_freedom",
    "described", "followed", "light_of", "make_scene", "mapped", "parameter_table", "propagated",
    "psf_shape", "read_fit", "sensitivity_profiles", "smoothed", "with_slopes", "write_fit",
]  # fmt: skip

_UNITS = {"width": "pix", "diffusion": "pix", "offset": "pix", "position": "pix", "flux": "e-/s"}
_RATES = ("flux", "flux_err", "flux_scatter", "background", "background_err")
# Columns of `TPFFit.cadences`, and their units.
CADENCE_UNITS = {
    "time": "d",
    **dict.fromkeys(("cadenceno", "quality", "focus", "held_out", "outliers"), ""),
    **dict.fromkeys(("x", "x_err", "y", "y_err", "pos_corr"), "pixel"),
    **dict.fromkeys(_RATES, "electron / s"),
}
# Entries of `TPFFit.statistics`.
STATISTICS = (
    *("chi2", "n_data", "n_parameters", "error_scale", "converged", "n_steps", "chi2_held_out"),
)
# Reduced chi-squared above which a sensitivity is not measured: it describes errors of the PSF long
# before chi-squared shows them.
_TRUE_CHI2 = 1.1
_CREATOR, _VERSION = "scope_models fit", 2
_IMAGES = ("covariance", "interpixel", "interpixel_err", "observed", "observed_err", "fitted")
# Two periods of the roll of K2: what is faster is the pixels', not the star's.
_SMOOTHING_DAYS = 0.5
# Pixels below this part of the brightest one have the noise without light.
_FAINT = 0.05
_FEWEST_CADENCES = 20
# Probability of what is not by chance.
_CHANCE = 0.01
# Bands of frequency in which power is compared with the noise.
_BANDS = 40
# Step of a derivative, in errors of the parameter, and at most.
_STEP, _LARGEST_STEP = 0.05, 1e-3
# Reach of a contour from the center, pixels; directions and radii in which it is sought.
_REACH, _DIRECTIONS, _RADII = 8.0, 90, 801
# Part of all light that any pixel may hold beside a Gaussian.
_EVERYWHERE = 0.003


@dataclass(frozen=True, eq=False, repr=False)
class FittedStar(Value):
    """Another star in a fit.

    Parameters
    ----------
    x, y, flux : ndarray of shape (n,)
        Position in pixels and flux in e-/s, by cadence.
    x_err, y_err, flux_err : ndarray of shape (n,)
        Their errors.

    Examples
    --------
    >>> import numpy as np
    >>> from scope_models.fitting import FittedStar
    >>> star = FittedStar(*np.ones((6, 5)))
    >>> star.flux.shape
    (5,)
    """

    x: np.ndarray
    y: np.ndarray
    flux: np.ndarray
    x_err: np.ndarray
    y_err: np.ndarray
    flux_err: np.ndarray

    def __post_init__(self):
        for value in vars(self).values():
            value.flags.writeable = False


def parameter_table(model, free, values, covariance, at_bounds, statistics):
    """`TPFFit.parameters`; ``free`` are kinds by name, with values and their covariance."""
    unknown, reduced = set(at_bounds), statistics["chi2"] / degrees_of_freedom(statistics)
    has_response = np.isfinite(statistics["chi2_held_out"])
    if has_response or statistics["error_scale"] > 1 or reduced > _TRUE_CHI2:
        unknown |= set(model.response_powers)
    errors = np.where([name in unknown for name in free], np.nan, np.sqrt(np.diag(covariance)))
    names = [*free, *(name for name in model.param_names[3:] if name not in free)]
    numbers = numbers_of(model) | dict(zip(free, values, strict=True))
    kinds = [(model.parameter_kinds | free).get(name, "other") for name in names]
    columns = {
        "name": names, "value": [numbers[name] for name in names],
        "error": [*errors, *[0.0] * (len(names) - len(free))],
        "unit": [_UNITS.get(kind, "") for kind in kinds],
        "fixed": [name not in free for name in names], "kind": kinds,
        "at_bound": [name in at_bounds for name in names],
    }  # fmt: skip
    table = Table(columns, dtype=("U32", float, float, "U8", bool, "U16", bool))
    table["value"].info.format, table["error"].info.format = ".6g", ".2g"
    return table


def degrees_of_freedom(statistics):
    return max(statistics["n_data"] - statistics["n_parameters"], 1)


def cadence_table(columns):
    names = [name for name in CADENCE_UNITS if columns.get(name) is not None]
    units = {name: CADENCE_UNITS[name] or None for name in names}
    return Table({name: columns[name] for name in names}, units=units)


def write_fit(fit, path, *, overwrite):
    from astropy.io import fits

    primary = fits.PrimaryHDU()
    primary.header["CREATOR"] = _CREATOR
    primary.header["FITVERS"] = (_VERSION, "version of this format")
    columns = []
    for column in fit.cadences.itercols():
        unit = str(column.unit or "").replace("electron / s", "e-/s")  # FITS has no electron
        kind = {"i": "K", "u": "K", "b": "L"}.get(column.dtype.kind, "D")
        for number, part in enumerate(np.atleast_2d(column.T), start=1):
            name = f"{column.name.upper()}{number if column.ndim > 1 else ''}"
            columns.append(fits.Column(name, kind, unit=unit or None, array=np.asarray(part)))
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
    names = [name for name in CADENCE_UNITS if name.upper() in table.names]
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
    statistics = {name: described.get(name, np.nan) for name in STATISTICS}
    if described["options"]["interpixel"] is None:
        described["options"]["interpixel"] = np.inf
    free = dict(zip(described["names"], described["kinds"], strict=True))
    given = described["parameters"], values["covariance"], described["at_bounds"], statistics
    kept = {name: described[name] for name in ("options", "time_format", "meta")}
    return values | kept | {
        "model": model, "parameters": parameter_table(model, free, *given),
        "cadences": cadence_table(columns), "neighbors": tuple(FittedStar(*star) for star in cube),
        "response": tuple(PixelShares(**share) for share in shares),
        "detector": make_detector(detector, maps), "statistics": statistics,
    }  # fmt: skip


def _description(fit):
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
        pairs = zip((xy - path).T, (fit.x_err, fit.y_err), strict=True)
        xy = path + np.column_stack([denoised(fit, *pair) for pair in pairs])
    if common:
        path, _ = offsets_at(positions, fit.time, fit.time_format, fit.meta, fit.shape)
    if common or positions == "path":
        if path is None:
            raise ValueError("`positions` is 'path', but the file had no POS_CORR")
        known = np.isfinite(path).all(axis=1)
        xy[known] = mapped(path[known], xy[known])
    flux = np.median(fit.flux)
    if flux <= 0:
        raise ValueError(f"the star has no flux to simulate: its median is {flux:g} e-/s")
    detector = fit.detector.replace(read_noise=_read_noise(fit))
    middle, stars = np.median(xy, axis=0), []
    others = (np.median([star.x, star.y, star.flux], axis=1) for star in fit.neighbors)
    for x, y, light in ((*middle, flux), *others):
        if light > 0:
            mag = detector.zero_point_mag - 2.5 * np.log10(light / detector.zero_point)
            own = None if stars else _signal(fit, signal)
            stars.append(Star(float(mag), float(x), float(y), signal=own, psf=fit.psf))
    arrays = {name: getattr(fit, name) for name in ("time", "quality", "cadenceno", "time_format")}
    motion = Motion(x=xy[:, 0] - middle[0], y=xy[:, 1] - middle[1], **arrays)
    effects = () if np.all(fit.focus == 1) else (Focus(series=fit.focus),)
    if fit.response:
        left = denoised(fit, fit.background, fit.background_err)
        effects += (*fit.response, Background(left=left))
    return Scene(stars, detector, motion, effects=effects, **_identity(fit.meta, detector.mission))


def mapped(path, xy):
    """Positions ``(n, 2)`` as the affine map of a path that is nearest has them."""
    basis = np.column_stack([np.ones(len(path)), path])
    return basis @ np.linalg.lstsq(basis, xy, rcond=None)[0]


def _identity(cards, mission):
    names = {
        "object_name": "OBJECT", "ra": "RA_OBJ", "dec": "DEC_OBJ", "column": "1CRV5P",
        "row": "2CRV5P", "target_id": "KEPLERID" if "KEPLERID" in cards else "TICID",
    }  # fmt: skip
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
        # Unlike fitted fluxes, sums of pixels do not depend on errors of the PSF.
        light, expected = light_of(fit, fit.observed), light_of(fit, fit.fitted)
        ratio = np.divide(light, expected, out=np.ones_like(light), where=expected > 0)
        relative = smoothed(fit.time, relative * ratio)
        relative /= np.median(relative)
    return np.maximum(relative, 0.0)


def light_of(fit, cube):
    """Sums of all pixels less background, e-/s, ``(n,)``."""
    return np.nansum(cube - fit.background[:, None, None], axis=(1, 2))


def smoothed(time, values):
    step = np.median(np.diff(time)) if len(time) > 1 else 1.0
    size = min(2 * round(_SMOOTHING_DAYS / step / 2) + 1, 2 * (len(values) // 2) + 1)
    values = median_filter(values, size, mode="nearest")
    return uniform_filter1d(values, size, mode="nearest")


def described(fit):
    """Cadences that are no outliers."""
    return np.ones(len(fit.time), dtype=bool) if fit.outliers is None else ~fit.outliers


def followed(fit):
    """Return the rms of fast flux that a quadratic form of the position explains, 0 if by chance.

    Spans of the smoothing count as independent.
    """
    good = described(fit)
    if good.sum() < _FEWEST_CADENCES:
        return 0.0
    time, x, y, flux = (values[good] for values in (fit.time, fit.x, fit.y, fit.flux))
    x, y = x - x.mean(), y - y.mean()
    columns = [values - smoothed(time, values) for values in (flux, x, y, x * x, x * y, y * y)]
    fast, *terms = (column - column.mean() for column in columns)
    terms = np.column_stack(terms)
    part = terms @ np.linalg.lstsq(terms, fast, rcond=None)[0]
    free = max(min(np.ptp(time) / _SMOOTHING_DAYS, len(time)) - terms.shape[1] - 1, 1)
    noise = np.mean(fit.flux_scatter[good] ** 2)
    rest = max(np.mean((fast - part) ** 2) - noise, 0.0)
    expected = terms.shape[1] * (noise / len(time) + rest / free)
    ratio = np.mean(part**2) / max(expected, 1e-300)
    by_chance = f_distribution.sf(ratio, terms.shape[1], free) >= _CHANCE
    return 0.0 if by_chance else float(part.std())


def denoised(fit, values, error):
    """Values ``(n,)`` with the power of their variations that errors do not explain."""
    slow, out = smoothed(fit.time, values), fit.outliers
    fast = np.where(out, 0.0, values - slow)
    spectrum = np.fft.rfft(fast)
    power = uniform_filter1d(np.abs(spectrum) ** 2, max(len(spectrum) // _BANDS, 3))
    # The pixels scatter by more than their errors.
    noise = np.sum(np.where(out, 0.0, error) ** 2) * max(fit.reduced_chi2, 1.0)
    part = np.clip(1 - noise / np.maximum(power, 1e-300), 0.0, 1.0)
    return slow + np.fft.irfft(np.sqrt(part) * spectrum, len(fast))


def _read_noise(fit):
    """Noise per read with which faint pixels scatter as those of the file."""
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
    """Offsets and, by axis, fitted sensitivity and error, NaN at a bound; or None."""
    model = fit.sensitivity
    if not isinstance(model, SensitivityPolynomial):
        return None
    offset = np.linspace(-0.5, 0.5, 51)
    profiles = {"offset": offset}
    for axis in "xy":
        powers = {name: offset**power for name, (of, power) in model.powers.items() if of == axis}
        value = sum(getattr(model, name).value * term for name, term in powers.items())
        terms = [powers.get(name, np.zeros_like(offset)) for name in fit.names]
        error = propagated(np.reshape(terms, (-1, len(offset))), fit.covariance)
        known = all(fit.errors[name] > 0 for name in fit.names if name in powers)
        profiles[axis] = value, error if known else error * np.nan
    return profiles


def propagated(slopes, covariance):
    """Errors of quantities with derivatives ``(s, ...)`` by parameters with a covariance."""
    variance = np.einsum("i...,ij,j...->...", slopes, covariance, slopes, optimize=True)
    return np.sqrt(np.maximum(variance, 0.0))


def with_slopes(fit, measure):
    """Return a measure of the PSF, and derivatives by the free parameters, ``(s, ...)``."""
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
    # Small, for the axes of a circle have no direction.
    steps = np.minimum(_STEP * np.sqrt(np.diag(covariance)) + 1e-12, _LARGEST_STEP * moments[0])
    by = np.array([_axes(moments + step) - values for step in np.diag(steps)])
    by[:, -1] = (by[:, -1] + 90) % 180 - 90
    table = Table({
        "name": ("fwhm", "fwhm_major", "fwhm_minor", "ellipticity", "angle"), "value": values,
        "error": propagated(by / steps[:, None], covariance), "unit": ("pix",) * 3 + ("", "deg"),
    })  # fmt: skip
    table["value"].info.format, table["error"].info.format = ".4g", ".2g"
    return table


def _moments_of_shares(fit):
    """Moments, as `_moments`, of a Gaussian fitted to typical shares, and their covariance."""
    x, y, time = (np.median(values) for values in (fit.x, fit.y, fit.time))
    shares = fit.model.unit_images(fit.shape, x, y) + fit.response[0].changes([x], [y], [time])[0]
    used = np.isfinite(fit.fitted).any(axis=0)
    # Pixels scatter about it by a part of their light, and of all light in faint ones.
    weight = 1 / (np.abs(shares) + _EVERYWHERE)
    gaussian = PRF(BivariateGaussianPSF())

    def residual(values):
        gaussian.parameters = values
        return (weight * (gaussian.unit_images(fit.shape) * values[0] - shares))[used]

    lower = [0.0, x - 2, y - 2, *[0.1] * 2, -0.95]
    upper = [2.0, x + 2, y + 2, *[10.0] * 2, 0.95]
    found = least_squares(residual, [1.0, x, y, 0.5, 0.5, 0.0], bounds=(lower, upper))
    sigma_x, sigma_y, rho = found.x[3:]
    # Number and scatter of the bright pixels, which mostly determine the Gaussian.
    light = np.abs(shares)[used]
    number = light.sum() ** 2 / np.sum(light**2)
    variance = (light @ found.fun**2) / light.sum() * number / max(number - len(found.x), 1)
    covariance = variance * np.linalg.pinv(found.jac.T @ found.jac)[3:, 3:]
    # Second moments of a Gaussian's area above half of its largest value.
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
    xx, yy, xy = moments
    half, turned = (xx + yy) / 2, np.hypot((xx - yy) / 2, xy)
    major, minor = 4 * np.sqrt(half + turned), 4 * np.sqrt(half - turned)
    angle = np.degrees(np.arctan2(2 * xy, xx - yy)) / 2
    return np.array([np.sqrt(major * minor), major, minor, 1 - minor / major, angle])
