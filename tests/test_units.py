"""Every public argument with a unit converts quantities, or the error names the argument.

The arguments are found in the docstrings: numbers whose description names a unit. Each one needs a
row below, or a reason why it has none.
"""

import dataclasses
import inspect
import re
import warnings

import astropy.units as u
import matplotlib.pyplot as plt
import numpy as np
import pytest
from astropy.coordinates import EarthLocation, SkyCoord
from astropy.modeling.fitting import TRFLSQFitter
from astropy.table import MaskedColumn
from astropy.time import Time, TimeDelta
from astropy.utils.masked import Masked
from numpydoc.docscrape import NumpyDocString

from scope_models import (
    PRF,
    BivariateGaussianPSF,
    Detector,
    Motion,
    Scene,
    SensitivityPolynomial,
    Star,
    TransitModel,
    fit_tpf,
    generate_target,
    integrate_pixels,
    simulate,
)
from scope_models import photometry as ph
from scope_models import plotting as pl
from scope_models._arrays import plain_array, plain_number, plain_time
from scope_models.benchmark import SkyRegime
from scope_models.correctors import PLDOptions
from scope_models.effects import Effect, Focus, Gaps, ScatteredLight, airmass, moon_geometry
from scope_models.effects.charge import rejected_shift
from scope_models.exceptions import FitWarning
from scope_models.fitting import FitOptions
from scope_models.io import TPFMetadata, usable_positions
from scope_models.io.tpf import make_tpf_hdulist
from scope_models.missions import MISSIONS
from scope_models.models import (
    CorrectedPRF,
    DiffusionSensitivity,
    GaussHermitePSF,
    PRFGrid,
    TabulatedPRF,
    TabulatedPSF,
    moffat_psf,
    sinusoidal_signal,
    stochastic_signal,
    tabulated_signal,
)
from scope_models.plotting.detrending import plot_detrending, plot_detrending_masks
from scope_models.scene import K2Roll
from scope_models.scene._pointing import Pointing

RATE = u.electron / u.s
PPM = u.Unit(1e-6)
TIME = np.array([1.0, 2.0, 3.0])
IMAGE = np.array([[20.0, 100.0], [20.0, 0.5]])
NUMBER = re.compile(r"float|array_like|ndarray|Quantity|Time\b|SkyCoord")
UNIT = re.compile(
    r"(?<![\w-])(days?|hours?|px|pixels?|e-(/s)?|[Ee]lectrons?|n?m|KEPMAG|arcsec(/h)?|deg(rees)?|mag(nitudes?)?"
    r"|ppm|km/s|s|DN|BKJD|BTJD)(?![\w-])"
)


def field(kind, item, **others):
    """Return what makes a frozen object with one field and reads it back."""
    return lambda value: getattr(kind(**{item: value}, **others), item)


def parameter(make, name):
    """Return what makes a model with one parameter and reads its value in the given unit."""

    def read(value):
        found = getattr(make(**{name: value}), name)
        plain = found.value if found.unit is None else found.quantity
        return plain_array(plain, MODEL_UNITS[name], name)

    return read


def target():
    return generate_target(ncadences=20, apsize=7, seed=1, no_sensitivity_variation=True)


def neighbor(options):
    return target().add_neighbor(**options).neighbors[0]


def drawn(function, *arguments, **options):
    """Return the data of the first line that a function draws, then close the figure."""

    def read(value):
        places = [value if argument is VALUE else argument for argument in arguments]
        named = {key: value if item is VALUE else item for key, item in options.items()}
        result = function(*places, **named)
        axes = result if hasattr(result, "figure") else plt.gcf().axes[0]
        data = [line.get_xydata() for line in axes.lines]
        data += [np.asarray(c.get_offsets()) for c in axes.collections]
        labels = [text.get_text() for text in getattr(axes.get_legend(), "get_texts", list)()]
        plt.close("all")
        return np.concatenate([np.ravel(part) for part in data] or [np.zeros(1)]), labels

    return read


VALUE = object()
GENERATORS = ("kepler", "tess", "k2_final_campaign", "ground", "random_walk", "failing_wheels")
FIT = {"data": IMAGE, "model": IMAGE, "residual": IMAGE, "x": TIME, "y": TIME, "flux": TIME}
PLACES = [(1, 1), (1, 101), (101, 1), (101, 101)]
GRID = PRFGrid(PLACES, [TabulatedPRF(np.eye(7) + column) for column, _ in PLACES])
MODEL_UNITS = {
    "flux": RATE,
    "x_0": u.pix,
    "y_0": u.pix,
    "sigma_x": u.pix,
    "sigma_y": u.pix,
    "period": u.day,
    "t0": u.day,
    "inc": u.deg,
    "omega": u.deg,
}
DETECTOR = {"shape": (3, 4), "zero_point": 1e5, "zero_point_mag": 10.0, "int_time": 2.0}
TPF = {
    "metadata": "K2",
    "time": TIME,
    "flux": np.ones((3, 2, 2)),
    "flux_err": np.full((3, 2, 2), 0.1),
}


def detector(name, value):
    return getattr(Detector(**(DETECTOR | {name: value})), name)


PARANAL = EarthLocation.from_geodetic(-70.40, -24.63, 2635)
NORTH = SkyCoord(40.0, -20.0, unit="deg")


def ground(**changes):
    made = Detector.ground(**changes)
    return [made.background, made.psf[0].sigma_x.value, made.effects[1].rms(1.0)]


def cataloged(**options):
    table = {"ra": [40, 40.002], "dec": [-20, -20.002], "mag": [12, 15]}
    table |= {"pmra": [0.0, 100.0], "pmdec": [0.0, 0.0]}
    scene = Scene.from_catalog(
        table, NORTH, Detector.k2(), Motion.still(3), **({"ref_epoch": 2010.0} | options)
    )
    return scene.positions


def column(name, value):
    rows = make_tpf_hdulist(**(TPF | {name: value}))[1].data
    return np.array(rows[name.upper()], dtype=float)


def animated(time, **options):
    animation = pl.animate_pixels(np.ones((3, 2, 2)), time, **options)
    animation._draw_was_started = True  # it warns if nobody looks at it
    return animation


def fitted(name):
    def read(value):
        observation = simulate(Star(12.0), Detector.k2(shape=(5, 5)), Motion.k2_roll(8), seed=1)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", FitWarning)
            given = {name: value}
            of_call = {"flux_err"} & given.keys()
            few = FitOptions(max_steps=1, **({} if of_call else given))
            return fit_tpf(
                observation.to_tpf(), psf=1, options=few, **(given if of_call else {})
            ).flux

    return read


def transit(make, name, **others):
    def read(value):
        model = make(**(others | {name: value}))
        return np.append(model.parameters, model.exposure_time)

    return read


FROM_DEPTH = {"depth": 0.01, "duration": 0.1, "period": 4.0}
FROM_ORBIT = {"period": 4.0, "a": 10.0}
# Argument: (a function of its value, a plain value, the documented unit).
ROWS = {
    **{
        f"{name}.{field_}": (parameter(kind, field_), value, MODEL_UNITS[field_])
        for name, kind in {
            "BivariateGaussianPSF": BivariateGaussianPSF,
            "GaussHermitePSF": GaussHermitePSF,
        }.items()
        for field_, value in {"x_0": 1.0, "y_0": 2.0, "sigma_x": 0.6, "sigma_y": 0.7}.items()
    },
    **{
        f"TransitModel.{name}": (parameter(TransitModel, name), value, MODEL_UNITS[name])
        for name, value in {"period": 3.0, "t0": 1.0, "inc": 88.0, "omega": 60.0}.items()
    },
    "TransitModel.exposure_time": (lambda v: TransitModel(exposure_time=v).exposure_time, 0.1, u.d),
    **{
        f"TransitModel.from_depth_duration.{name}": (
            transit(TransitModel.from_depth_duration, name, **FROM_DEPTH), value, u.day
        )
        for name, value in {"duration": 0.1, "period": 4.0, "t0": 1.0, "exposure_time": 0.1}.items()
    },
    **{
        f"TransitModel.from_orbit.{name}": (
            transit(TransitModel.from_orbit, name, **FROM_ORBIT), value, unit
        )
        for name, value, unit in (
            ("period", 4.0, u.day), ("t0", 1.0, u.day), ("exposure_time", 0.1, u.day),
            ("inc", 88.0, u.deg), ("omega", 40.0, u.deg),
        )
    },
    "SensitivityPolynomial.x_coefficients": (
        lambda v: SensitivityPolynomial(v).x_coefficients, [1.0, 0.0, -0.1], u.one
    ),
    "SensitivityPolynomial.y_coefficients": (
        lambda v: SensitivityPolynomial(y_coefficients=v).y_coefficients, [1.0, 0.0, -0.1], u.one
    ),
    "PRF.unit_images.x_0": (
        lambda v: PRF(BivariateGaussianPSF()).unit_images((3, 3), x_0=v, y_0=1.0), 1.2, u.pix
    ),
    "PRF.unit_images.y_0": (
        lambda v: PRF(BivariateGaussianPSF()).unit_images((3, 3), x_0=1.0, y_0=v), 1.2, u.pix
    ),
    "PRF.render.x_0": (
        lambda v: PRF(BivariateGaussianPSF()).render((3, 3), x_0=v, y_0=1.0), 1.2, u.pix
    ),
    "PRF.render.y_0": (
        lambda v: PRF(BivariateGaussianPSF()).render((3, 3), x_0=1.0, y_0=v), 1.2, u.pix
    ),
    "integrate_pixels.x": (
        lambda v: integrate_pixels(BivariateGaussianPSF(), x=v, y=[0.0, 1.0]), [0.0, 1.0], u.pix
    ),
    "integrate_pixels.y": (
        lambda v: integrate_pixels(BivariateGaussianPSF(), x=[0.0, 1.0], y=v), [0.0, 1.0], u.pix
    ),
    "contamination_aperture.min_fraction": (
        lambda v: ph.contamination_aperture(IMAGE, IMAGE[::-1], min_fraction=v), 0.9, u.one
    ),
    "circular_aperture.min_overlap": (
        lambda v: ph.circular_aperture((5, 5), 2, 2, 1.5, min_overlap=v), 0.9, u.one
    ),
    "Detector.interpixel": (
        lambda v: Detector.k2(shape=(2, 2), interpixel=v).interpixel, np.full((2, 2), 0.9), u.one
    ),
    "rejected_shift.charge": (rejected_shift, [1.0, 2.0], u.one),
    "animate_pixels.interval": (
        lambda v: animated(TIME, interval=v)._interval, 30.0, u.ms
    ),
    **{
        f"SkyRegime.{name}": (field(SkyRegime, name, name="mine"), value, unit)
        for name, value, unit in (
            ("magnitude", 13.0, u.mag), ("period", 2.0, u.day), ("transit_period", 2.0, u.day),
            ("duration", 0.1, u.day), ("focus_period", 5.0, u.day), ("cadence", 0.1, u.day),
            ("depth", 0.01, u.one),
            ("background", 5.0, RATE),
        )
    },
    "sinusoidal_signal.period": (lambda v: sinusoidal_signal(0.1, v)(TIME), 4.0, u.day),
    "tabulated_signal.time": (lambda v: tabulated_signal(v, [1, 0.9, 1])(TIME / 2), TIME, u.day),
    "stochastic_signal.time": (
        lambda v: stochastic_signal(v, 50, seed=1)(TIME), np.arange(200) / 48, u.day
    ),
    **{
        f"stochastic_signal.{name}": (
            lambda v, name=name: stochastic_signal(
                np.arange(200) / 48, **({"cdpp": 50.0, "seed": 1} | {name: v})
            )(TIME),
            value,
            unit,
        )
        for name, value, unit in (
            ("cdpp", 40.0, PPM), ("timescale", 0.3, u.day), ("duration", 5.0, u.hour)
        )
    },
    **{
        f"Detector.{name}": (lambda v, name=name: detector(name, v), value, unit)
        for name, value, unit in (
            ("zero_point", 2e5, RATE), ("zero_point_mag", 11.0, u.mag), ("int_time", 3.0, u.s),
            ("pixel_scale", 4.0, u.arcsec), ("read_time", 0.5, u.s), ("live_fraction", 0.8, u.one),
            ("gain", 100.0, u.electron / u.adu), ("read_noise", 90.0, u.electron),
            ("background", 100.0, RATE), ("well_depth", 1e6, u.electron),
        )
    },
    **{
        f"Detector.{name}.cadence": (lambda v, n=name: Detector.preset(n, v).n_frames, value, u.s)
        for name, value in {
            "kepler": 1765.5, "k2": 58.8, "k2_calibrated": 1765.5, "tess": 20.0
        }.items()
    },
    "Detector.flux_from_mag.mag": (Detector.k2().flux_from_mag, [12.0, 13.0], u.mag),
    "Mission.cadence.choice": (lambda v: MISSIONS["TESS"].cadence(v).n_frames, 600.0, u.s),
    "Motion.time": (lambda v: Motion(v, TIME, TIME).time, TIME, u.day),
    "Motion.x": (lambda v: Motion(TIME, v, TIME).x, TIME, u.pix),
    "Motion.y": (lambda v: Motion(TIME, TIME, v).y, TIME, u.pix),
    "Motion.from_arrays.time": (lambda v: Motion.from_arrays(v, TIME, TIME).time, TIME, u.day),
    "Motion.from_arrays.x": (lambda v: Motion.from_arrays(TIME, v, TIME).x, TIME, u.pix),
    "Motion.from_arrays.y": (lambda v: Motion.from_arrays(TIME, TIME, v).y, TIME, u.pix),
    "Motion.from_arrays.pixel_scale": (
        lambda v: Motion.from_arrays(TIME, TIME * u.arcsec, TIME, pixel_scale=v).x, 3.98, u.arcsec
    ),
    "Motion.still.start": (lambda v: Motion.still(3, start=v).time, 7.0, u.day),
    "Motion.still.cadence": (lambda v: Motion.still(3, cadence=v).time, 0.1, u.day),
    "Motion.k2_roll.start": (lambda v: Motion.k2_roll(3, start=v).time, 7.0, u.day),
    "Motion.statistics.pixel_scale": (
        lambda v: Motion.still(3).statistics(v).pixel_scale.value, 3.98, u.arcsec
    ),
    **{
        f"K2Roll.{name}": (field(K2Roll, name), value, unit)
        for name, value, unit in (
            ("field", (3.0, 2.0), u.deg), ("solar_rate", 2.0, u.arcsec / u.hour),
            ("reversal", 9.0, u.day), ("reversal_interval", 30.0, u.day),
            ("rate_growth", 0.02, u.hour**-1), ("reset_interval", 6.0, u.hour),
            ("reset_jitter", 0.1, u.hour), ("deadband", 10.0, u.arcsec),
            ("reset_scatter", 7.0, u.arcsec), ("roll_jitter", 0.3, u.arcsec),
            ("roll_jitter_time", 1.0, u.hour), ("pointing_jitter", 0.004, u.arcsec),
            ("orbital_speed", 29.0, u.km / u.s), ("campaign", 70.0, u.day),
            ("pixel_scale", 4.0, u.arcsec),
        )
    },
    **{
        f"{kind.__name__}.{name}": (field(kind, name), default, unit)
        for kind in Pointing.__subclasses__()
        for name, item in kind.__dataclass_fields__.items()
        if "unit" in item.metadata
        for unit, default in [(u.Unit(item.metadata["unit"]), item.default)]
    },
    **{
        f"Motion.{name}.start": (
            lambda v, name=name: getattr(Motion, name)(3, start=v).time, 7.0, u.day
        )
        for name in GENERATORS
    },
    "Motion.kepler.cadence": (lambda v: Motion.kepler(3, cadence=v).time, 58.85, u.s),
    "Motion.tess.cadence": (lambda v: Motion.tess(3, cadence=v).time, 20.0, u.s),
    **{
        f"Detector.ground.{name}": (lambda v, name=name: ground(**{name: v}), value, unit)
        for name, value, unit in (
            ("aperture", 2.0, u.m),
            ("altitude", 2000.0, u.m),
            ("seeing", 1.5, u.arcsec),
            ("pixel_scale", 0.5, u.arcsec),
        )
    },
    **{
        f"Scene.from_catalog.{name}": (lambda v, name=name: cataloged(**{name: v}), value, unit)
        for name, value, unit in (
            ("orientation", 30.0, u.deg),
            ("magnitude_limit", 14.0, u.mag),
            ("background_stars", 20.0, u.mag),
            ("ref_epoch", 2000.0, u.yr),
        )
    },
    "airmass.time": (lambda v: airmass(v, NORTH, PARANAL), [1400.5, 1400.6], u.day),
    "moon_geometry.time": (
        lambda v: moon_geometry(v, NORTH, PARANAL)["moon_phase"], [1400.5, 1400.6], u.day
    ),
    "moffat_psf.fwhm": (lambda v: moffat_psf(v)(1.0, 2.0), 2.5, u.pix),
    "Motion.ground.cadence": (lambda v: Motion.ground(3, cadence=v).time, 30.0, u.s),
    "Motion.random_walk.cadence": (lambda v: Motion.random_walk(3, cadence=v).time, 0.1, u.day),
    "Motion.failing_wheels.cadence": (
        lambda v: Motion.failing_wheels(3, cadence=v).time, 0.1, u.day
    ),
    "Star.mag": (lambda v: Star(v).mag, 12.0, u.mag),
    "Star.x_0": (lambda v: Star(12, x_0=v).x_0, 3.0, u.pix),
    "Star.y_0": (lambda v: Star(12, y_0=v).y_0, 3.0, u.pix),
    "Star.signal": (lambda v: Star(12, signal=v).relative_flux(TIME), [1.0, 0.5, 1.0], u.one),
    "Star.relative_flux.time": (
        Star(12, signal=lambda time: 1 + time / 10).relative_flux, TIME, u.day
    ),
    **{
        f"Scene.{name}": (
            lambda v, name=name: getattr(
                Scene(Star(12.0), Detector.k2(), Motion.still(3), **{name: v}), name
            ),
            value,
            u.deg,
        )
        for name, value in {"ra": 20.0, "dec": -30.0, "orientation": 10.0}.items()
    },
    **{
        f"TPFMetadata.{name}": (
            lambda v, name=name: getattr(
                TPFMetadata(mission="K2", target_id=1, **{name: v}), name
            ),
            value,
            unit,
        )
        for name, value, unit in (
            ("pixel_scale", 4.0, u.arcsec), ("int_time", 6.0, u.s), ("read_time", 0.5, u.s),
            ("ra", 10.0, u.deg), ("dec", 20.0, u.deg), ("x_0", 2.0, u.pix), ("y_0", 2.0, u.pix),
            ("orientation", 30.0, u.deg), ("time_delta", 0.02, u.day),
            ("read_noise", 90.0, u.electron), ("gain", 110.0, u.electron / u.adu),
            ("magnitude", 12.0, u.mag),
        )
    },
    **{
        f"make_tpf_hdulist.{name}": (lambda v, name=name: column(name, v), value, unit)
        for name, value, unit in (
            ("time", TIME, u.day), ("timecorr", TIME / 1000, u.day),
            ("flux", np.full((3, 2, 2), 7.0), RATE), ("flux_err", np.full((3, 2, 2), 0.2), RATE),
            ("flux_bkg", np.full((3, 2, 2), 7.0), RATE),
            ("flux_bkg_err", np.full((3, 2, 2), 7.0), RATE),
            ("cosmic_rays", np.full((3, 2, 2), 7.0), RATE),
            ("pos_corr1", TIME, u.pix), ("pos_corr2", TIME, u.pix),
        )
    },
    "usable_positions.pos_corr": (usable_positions, [[0.1, 60.0], [0.1, 0.2]], u.pix),
    "cdpp.duration": (
        lambda v: ph.cdpp(1 + 1e-4 * np.sin(np.arange(500) ** 2), v), 6.5, u.hour
    ),
    "cdpp.cadence": (
        lambda v: ph.cdpp(1 + 1e-4 * np.sin(np.arange(500) ** 2), cadence=v), 0.03, u.day
    ),
    "threshold_aperture.target": (lambda v: ph.threshold_aperture(v, 10), IMAGE, RATE),
    "threshold_aperture.threshold": (lambda v: ph.threshold_aperture(IMAGE, v), 30.0, RATE),
    **{
        f"signal_to_noise_aperture.{name}": (
            lambda v, name=name: ph.signal_to_noise_aperture(
                **({"target": IMAGE, "exposure_time": 10.0} | {name: v})
            ),
            value,
            unit,
        )
        for name, value, unit in (
            ("target", IMAGE, RATE), ("background", 100.0, RATE), ("read_noise", 10.0, u.electron),
            ("exposure_time", 5.0, u.s),
        )
    },
    "contamination_aperture.target": (
        lambda v: ph.contamination_aperture(v, IMAGE[::-1]), IMAGE, RATE
    ),
    "crowding.target": (lambda v: ph.crowding(v, IMAGE[::-1], IMAGE > 50), IMAGE, RATE),
    "flux_fraction.target": (lambda v: ph.flux_fraction(v, IMAGE > 50), IMAGE, RATE),
    "flux_fraction.total": (lambda v: ph.flux_fraction(IMAGE, IMAGE > 50, v), 200.0, RATE),
    **{
        f"moving_aperture.{name}": (
            lambda v, name=name: ph.moving_aperture(
                (5, 5), **({"x": TIME, "y": TIME, "radius": 1.5} | {name: v})
            ),
            value,
            u.pix,
        )
        for name, value in {"x": 2 * TIME, "y": 2 * TIME, "radius": 2.0, "edge": 0.2}.items()
    },
    "aperture_flux.flux": (
        lambda v: ph.aperture_flux(v, IMAGE > 50), np.stack([IMAGE, IMAGE]), RATE
    ),
    "aperture_flux.flux_err": (
        lambda v: ph.aperture_flux(np.stack([IMAGE, IMAGE]), IMAGE > 50, v),
        np.stack([IMAGE, IMAGE]),
        RATE,
    ),
    "circular_aperture.x_0": (lambda v: ph.circular_aperture((5, 5), v, 2, 1.5), 2.2, u.pix),
    "circular_aperture.y_0": (lambda v: ph.circular_aperture((5, 5), 2, v, 1.5), 2.2, u.pix),
    "circular_aperture.radius": (lambda v: ph.circular_aperture((5, 5), 2, 2, v), 1.5, u.pix),
    "PLDOptions.segments": (lambda v: PLDOptions(segments=v).segments, [3.0, 5.0], u.day),
    "PLDOptions.saturation": (lambda v: PLDOptions(saturation=v).saturation, 1e4, RATE),
    "generate_target.mag": (
        lambda v: generate_target(v, ncadences=5, apsize=5, seed=1).star.mag, 12.0, u.mag
    ),
    "generate_target.background_level": (
        lambda v: generate_target(
            background_level=v, ncadences=5, apsize=5, seed=1
        ).detector.background,
        100.0,
        RATE,
    ),
    "generate_target.coords": (
        lambda v: generate_target(coords=v, ncadences=5, apsize=7, seed=1).star.x_0,
        (3.0, 2.0),
        u.pix,
    ),
    "generate_target.neighbor_magdiff": (
        lambda v: generate_target(
            neighbor=True, neighbor_magdiff=v, ncadences=5, apsize=7, seed=1
        ).neighbors[0].mag,
        1.0,
        u.mag,
    ),
    **{
        f"Target.add_transit.{name}": (
            lambda v, name=name: target().add_transit(**{name: v}).transits[0].parameters,
            value,
            u.day,
        )
        for name, value in {"per": 12.0, "dur": 0.4, "t0": 3.0}.items()
    },
    "Target.add_variability.freq": (
        lambda v: target().add_variability(freq=v).observation.truth.relative_flux,
        3.0,
        u.rad / u.day,
    ),
    **{
        f"Target.add_neighbor.{name}": (
            lambda v, name=name: [
                getattr(neighbor({"angle": 10.0, "dist": 2.0} | {name: v}), key)
                for key in ("mag", "x_0", "y_0")
            ],
            value,
            unit,
        )
        for name, value, unit in (
            ("magdiff", 2.0, u.mag), ("dist", 1.5, u.pix), ("angle", 30.0, u.deg)
        )
    },
    "plot_light_curve.time": (drawn(pl.plot_light_curve, VALUE, [1.0, 2.0, 1.5]), TIME, u.day),
    "plot_light_curve.cdpp": (drawn(pl.plot_light_curve, TIME, TIME, cdpp=VALUE), 20.0, PPM),
    "plot_light_curve.corrected_cdpp": (
        drawn(pl.plot_light_curve, TIME, TIME, TIME, corrected_cdpp=VALUE), 20.0, PPM
    ),
    "plot_summary.time": (
        drawn(pl.plot_summary, VALUE, IMAGE, TIME, TIME, TIME), TIME, u.day
    ),
    "plot_summary.x": (drawn(pl.plot_summary, TIME, IMAGE, TIME, VALUE, TIME), TIME, u.pix),
    "plot_summary.y": (drawn(pl.plot_summary, TIME, IMAGE, TIME, TIME, VALUE), TIME, u.pix),
    "plot_summary.cdpp": (
        drawn(pl.plot_summary, TIME, IMAGE, TIME, TIME, TIME, cdpp=VALUE), 20.0, PPM
    ),
    "plot_summary.corrected_cdpp": (
        drawn(pl.plot_summary, TIME, IMAGE, TIME, TIME, TIME, corrected=TIME, corrected_cdpp=VALUE),
        20.0,
        PPM,
    ),
    **{
        f"plot_fold.{name}": (
            drawn(
                pl.plot_fold,
                **({"time": TIME, "flux": TIME, "period": 2.0, "t0": 1.0} | {name: VALUE}),
            ),
            value,
            unit,
        )
        for name, value, unit in (
            ("time", TIME, u.day), ("period", 1.5, u.day), ("t0", 0.5, u.day),
            ("window", 20.0, u.hour),
        )
    },
    **{
        f"plot_motion.{name}": (
            drawn(pl.plot_motion, **({"time": TIME, "x": TIME, "y": TIME} | {name: VALUE})),
            TIME,
            unit,
        )
        for name, unit in {"time": u.day, "x": u.pix, "y": u.pix}.items()
    },
    "plot_twin.time": (
        drawn(pl.plot_twin, VALUE, [TIME] * 2, [TIME] * 2, [np.ones((2, 2))] * 2), TIME, u.day
    ),
    **{
        f"{kind.__name__}.{name}": (
            lambda v, kind=kind, name=name: parameter(
                lambda **place: kind(np.ones((7, 7)), **place), name
            )(v),
            1.5,
            u.pix,
        )
        for kind in (TabulatedPSF, TabulatedPRF, CorrectedPRF)
        for name in ("x_0", "y_0")
    },
    "CorrectedPRF.radius": (
        lambda v: CorrectedPRF(np.eye(7), order=2, radius=v, c_2_0=0.1)(1, 1), 1.5, u.pix,
    ),
    "DiffusionSensitivity.sigma_d": (lambda v: DiffusionSensitivity(v)(0.4, 0), 0.2, u.pix),
    "DiffusionSensitivity.response.dx": (
        lambda v: DiffusionSensitivity(0.2).response(v, 0), 0.4, u.pix,
    ),
    "DiffusionSensitivity.response.dy": (
        lambda v: DiffusionSensitivity(0.2).response(0, v), 0.4, u.pix,
    ),
    "PRFGrid.at.column": (lambda v: GRID.at(v, 20)(1, 0), 51.0, u.pix),
    "PRFGrid.at.row": (lambda v: GRID.at(51, v)(1, 0), 20.0, u.pix),
    "FitOptions.position_error": (fitted("position_error"), 0.2, u.pix),
    "FitOptions.focus": (fitted("focus"), 0.1, u.day),
    "fit_tpf.flux_err": (fitted("flux_err"), np.full((8, 5, 5), 50.0), RATE),
    **{
        f"plot_fit.{name}": (
            drawn(pl.plot_fit, **(FIT | {name: VALUE})), np.array(value, dtype=float), unit
        )
        for name, value, unit in (
            ("data", IMAGE, RATE), ("model", IMAGE, RATE), ("residual", IMAGE, RATE),
            ("x", TIME, u.pix), ("y", TIME, u.pix), ("pos_corr", np.ones((3, 2)), u.pix),
            ("time", TIME, u.day), ("flux", TIME, RATE),
        )
    },
    "plot_detrending_masks.image": (
        lambda v: [
            np.array(ax.images[0].get_array())
            for ax in plot_detrending_masks(v, IMAGE > 50, IMAGE)
        ],
        IMAGE,
        RATE,
    ),
    "animate_pixels.time": (lambda v: animated(v)._func(1)[1].get_text(), TIME, u.day),
    "plot_detrending.time": (drawn(plot_detrending, VALUE, TIME, TIME), TIME, u.day),
}  # fmt: skip
# Arguments that are passed on.
PASSED_ON = {
    "PRF.from_kepler.column": "PRFGrid.at.column",
    "PRF.from_kepler.row": "PRFGrid.at.row",
    "PRF.from_tess.column": "PRFGrid.at.column",
    "PRF.from_tess.row": "PRFGrid.at.row",
    "Target.estimate_cdpp.duration": "cdpp.duration",
    "Target.plot_transit.window": "plot_fold.window",
    "plot_fit.psf_extent": "plot_summary.x",
    "plot_scene.places": "plot_summary.x",
    "plot_scene.time": "plot_summary.time",
    "plot_scene.x": "plot_summary.x",
    "plot_scene.y": "plot_summary.y",
}
# Arguments in any unit, which cancels, and arrays that are changed in place.
ANY_UNIT = {
    "BivariateGaussianPSF.flux", "PRF.render.flux",
    "plot_light_curve.flux", "plot_fold.flux", "plot_detrending.flux",
    "plot_detrending.corrected", "plot_pixels.image", "animate_pixels.cube", "plot_summary.image",
    "plot_detector.image",
}  # fmt: skip
NO_UNIT = {
    # a description that names a unit of something else
    "Star.coord", "generate_target.roll", "SkyRegime.focus", "SkyRegime.neighbors",
    "fit_tpf.interpixel", "PLDCorrector.correct.transit_model",
    "PLDCorrector.correct.regressors", "CorrectedPRF.array", "CorrectedPRF.oversampling",
    "TabulatedPSF.array", "TabulatedPSF.oversampling",
    "TabulatedPRF.array", "TabulatedPRF.oversampling",
    "PLDCorrector.neighbors",
    "inject_files.star", "plot_precision.stars", "plot_precision.published", "plot_states.leaks",
    "fit_tpf.stars",
    "inject.signal", "inject.star", "TabulatedPRF.origin", "plot_detector.psf", "plot_psf.psf",
    "plot_detector.sensitivity", "plot_fit.chi2", "plot_twin.residuals",
    "plot_detrending_masks.scatter", "PLDCorrector.aperture_mask",
}  # fmt: skip
# Classes whose objects the package makes, and methods that astropy calls with numbers after it has
# converted them (test_contract.py).
MADE_BY_THE_PACKAGE = re.compile(
    r"(\w*(Fit|FittedStar|Result|Truth)|CommonMotion|Observation|PixelSeries|Mission|MessyStar|PRFGrid|Conditions|Exposures)\."
    r"|\w+\.(evaluate|fit_deriv|closed_form|unit_derivatives|track|times)\."
)


def is_effect(value):
    return inspect.isclass(value) and issubclass(value, Effect) and value is not Effect


def arguments_with_units(public_callables):
    """Return the public arguments whose descriptions name a unit."""
    found = set()
    for name, value in public_callables:
        for entry in NumpyDocString(inspect.getdoc(value) or "")["Parameters"]:
            text = " ".join([entry.type, *entry.desc])
            if NUMBER.search(entry.type) and "bool" not in entry.type and UNIT.search(text):
                found |= {f"{name}.{part.strip('*')}" for part in entry.name.split(", ")}
    return found


def test_every_argument_with_a_unit_has_a_row(public_callables):
    assert set(PASSED_ON.values()) <= set(ROWS)
    excused = ANY_UNIT | NO_UNIT | set(PASSED_ON)
    missing = {
        name
        for name in arguments_with_units(public_callables) - set(ROWS) - excused
        if not MADE_BY_THE_PACKAGE.match(name)
    }
    effects = {"Effect"} | {name for name, value in public_callables if is_effect(value)}
    assert sorted(name for name in missing if name.partition(".")[0] not in effects) == []


def test_effects_refuse_wrong_units_by_name(public_callables):
    """The tests of each effect compare quantities with plain numbers."""
    for effect in (value for _, value in public_callables if is_effect(value)):
        parts = dataclasses.fields(effect)
        needed = {item.name: 0.1 for item in parts if item.default is dataclasses.MISSING}
        for item in parts:
            if isinstance(item.default, float) or item.name in needed:
                with pytest.raises((TypeError, ValueError), match=f"`{item.name}`"):
                    effect(**(needed | {item.name: 1.0 * u.kg}))


def same(a, b):
    if isinstance(a, (list, tuple)) and a and isinstance(a[0], (list, tuple, np.ndarray)):
        return all(same(x, y) for x, y in zip(a, b, strict=True))
    if isinstance(a, str) or (isinstance(a, list) and a and isinstance(a[0], str)):
        return a == b
    return np.allclose(a, b, rtol=1e-9, atol=1e-12, equal_nan=True)


@pytest.mark.parametrize("name", ROWS)
def test_quantities_convert_or_the_argument_is_named(name):
    call, value, unit = ROWS[name]
    plain = call(value)
    scaled = (np.asarray(value) * unit).to(u.Unit(0.25 * unit))
    assert same(plain, call(scaled))
    argument = name.rpartition(".")[2]
    named = "cadence" if argument == "choice" else argument
    for wrong in (u.kg, u.cd / u.m):
        with pytest.raises((ValueError, TypeError), match=rf"`{named}`"):
            call(np.asarray(value) * wrong)
    plt.close("all")


def test_angles_need_a_pixel_scale():
    psf = BivariateGaussianPSF(sigma_x=1.99 * u.arcsec, sigma_y=0.5 * u.pix)
    no_scale = "`sigma_x` must be in pix, .* no pixel scale here"
    for refuse in (PRF, lambda p: integrate_pixels(p, (5, 5)), lambda p: Star(12, psf=p)):
        with pytest.raises(ValueError, match=no_scale):
            refuse(psf)
    wings = BivariateGaussianPSF(0.2, sigma_x=1.2, sigma_y=1.2)
    detector = Detector.k2(psf=psf + wings, pixel_scale=3.98)
    assert detector.psf.sigma_x_0.value == pytest.approx(0.5)
    assert detector == Detector.k2(psf=BivariateGaussianPSF() + wings)
    with pytest.raises(ValueError, match=r"`x` must be in pix, .* no pixel scale here"):
        Motion.from_arrays(TIME, TIME * u.arcsec, TIME)
    moved = Motion.from_arrays([0, 24] * u.hour, [0, 3.98] * u.arcsec, [0, 0], pixel_scale=detector)
    assert moved == Motion([0, 1], [0, 1], [0, 0], meta={"n_bad": 0})
    assert Motion.k2_roll(3, field=(1 * u.deg, 60 * u.arcmin)).meta["generator"]["field"] == (1, 1)


def test_times_of_any_format_and_scale():
    expected = [2144.1028, 2144.1232]
    time = Time(np.array(expected) + 2454833.0, format="jd", scale="tdb")
    for given in (time, time.utc, Time(time.tdb.isot, scale="tdb"), [time[0], time[1]]):
        motion = Motion(given, [0, 0], [0, 0])
        np.testing.assert_allclose(motion.time, expected, rtol=0, atol=2e-8)
    later = Motion(time, [0, 0], [0, 0], time_format="btjd").time
    np.testing.assert_allclose(later, np.array(expected) - 2167.0, rtol=0, atol=1e-8)
    assert Motion.still(1, start=time[0]).time[0] == pytest.approx(2144.1028, abs=1e-8)
    for julian in (2456977.1, 56976.6):
        with pytest.raises(ValueError, match=r"`time` must be BJD - 2454833 in days, got .*Julian"):
            Motion([julian, julian + 1], [0, 0], [0, 0])
    with pytest.raises(TypeError, match="`time` must be in days since an epoch of your own"):
        tabulated_signal(time, [1, 1])
    with pytest.raises(TypeError, match="`mag` must be numbers, got a Time"):
        Star(time[0])


def test_julian_dates_are_refused_where_times_of_the_mission_are_meant():
    julian = 2456977.1
    for name, call in {
        "intervals": lambda: Gaps([(julian, julian + 1)]),
        "events": lambda: Focus(events=[julian]),
        "perigee": lambda: ScatteredLight(perigee=julian),
        "segments": lambda: PLDOptions(segments=[julian]),
        "start": lambda: Motion.k2_roll(3, start=julian),
    }.items():
        with pytest.raises(ValueError, match=f"`{name}` must be .*as in Julian dates"):
            call()


def test_transits_have_the_zero_of_the_times():
    julian = TransitModel(t0=2456977.0)
    assert julian(2456977.0) < 1
    with pytest.raises(
        ValueError, match=r"`t0` must have the zero of the times, got the date 245697"
    ):
        simulate(Star(12.0, signal=julian), Detector.k2(), Motion.still(3))


def test_what_holds_no_numbers_is_refused():
    for wrong in (
        "5",
        ["5"],
        [b"5"],
        np.array(["2020-01-01"], dtype="M8[D]"),
        [1 + 2j],
        [object()],
    ):
        with pytest.raises(TypeError, match="`x` must"):
            plain_array(wrong, u.pix, "x")
    for wrong in (None, True, "5", [5.0]):
        with pytest.raises(TypeError, match="`x` must be"):
            plain_number(wrong, u.pix, "x")
    with pytest.raises(TypeError, match="`x` mixes units"):
        plain_array([1 * u.pix, 2 * u.s], u.pix, "x")
    assert plain_array([1 * u.hour, 2 * u.day], u.hour, "x").tolist() == [1, 48]
    assert plain_number(TimeDelta(2.0, format="jd"), u.hour, "x") == 48


def test_masked_values_keep_their_unit():
    column = MaskedColumn([1.0, 2.0], unit="hour", mask=[False, False])
    assert plain_array(column, u.min, "x").tolist() == [60, 120]
    column.mask[1] = True
    assert np.array_equal(plain_array(column, u.min, "x"), [60, np.nan], equal_nan=True)
    masked = Masked([1.0, 2.0] * u.hour, mask=[True, False])
    assert np.array_equal(plain_array(masked, u.min, "x"), [np.nan, 120], equal_nan=True)
    time = Time([2454834.0, 2454835.0], format="jd", scale="tdb")
    time[0] = np.ma.masked
    assert np.array_equal(plain_time(time, "bkjd", "x"), [np.nan, 2], equal_nan=True)


def test_nested_sequences_of_quantities():
    assert plain_array([(1 * u.hour, 2 * u.day)], u.hour, "x").tolist() == [[1, 48]]
    moved = Motion([0 * u.hour, 24 * u.hour], [0 * u.pix, 1 * u.pix], [0, 0])
    assert moved == Motion([0, 1], [0, 1], [0, 0])
    with pytest.raises(TypeError, match="`intervals` mixes units"):
        Gaps([(1 * u.hour, 2 * u.kg)])


def test_magnitudes_of_other_systems_are_refused():
    assert Star(u.Magnitude(12)).mag == 12
    for wrong in (12 * u.ABmag, u.Magnitude(12 * u.mag(u.electron / u.s))):
        with pytest.raises(ValueError, match=r"`mag` must be in mag, or convert to it, got mag\("):
            Star(wrong)


@pytest.mark.parametrize(
    "signal",
    [
        TransitModel(),
        sinusoidal_signal(0.1, 1.0),
        tabulated_signal(TIME, [1, 0.9, 1]),
        TransitModel() * sinusoidal_signal(0.1, 1.0),
    ],
    ids=["transit", "sine", "table", "product"],
)
def test_signals_convert_times(signal):
    np.testing.assert_allclose(signal(24 * TIME * u.hour), signal(TIME), rtol=1e-12)
    with pytest.raises((ValueError, u.UnitsError), match=r"must be in d|could not be"):
        signal(TIME * u.kg)


def test_transits_are_fitted_with_units():
    true = TransitModel.from_depth_duration(0.01, 3.5 * u.hour, 4.16 * u.day, 24 * u.hour)
    assert true.duration == pytest.approx(3.5 / 24)
    time = np.arange(0.5, 10, 0.01) * u.day
    fixed = dict.fromkeys(("inc", "ecc", "omega", "u1", "u2"), True)
    start = TransitModel(100 * u.hour, 1.01 * u.day, 0.09, a=true.a.value, fixed=fixed)
    fit = TRFLSQFitter()(start, time.to(u.hour), true(time))
    assert fit.period.quantity.to_value(u.day) == pytest.approx(4.16, abs=1e-5)
    assert fit.t0.quantity.to_value(u.hour) == pytest.approx(24, abs=1e-3)
    assert fit.duration == pytest.approx(true.duration, rel=1e-3)
    assert fit.depth == pytest.approx(0.01, rel=1e-3)
    np.testing.assert_allclose(fit(time), true(time), atol=1e-6)


def test_parameters_of_a_transit_are_checked_when_they_are_set():
    planet = TransitModel()
    for name, value in (("rp", -1), ("period", 0), ("a", -2), ("ecc", 1)):
        with pytest.raises(ValueError, match=f"`{name}` must be"):
            setattr(planet, name, value)
    planet.rp.value = -1  # which astropy does not check
    with pytest.raises(ValueError, match=r"`rp` must be at least 0, got -1\.0"):
        planet(0.0)
    with pytest.raises(TypeError, match="`t0` must be in days since an epoch of your own"):
        TransitModel(t0=Time(2456977.0, format="jd"))
    with pytest.raises(ValueError, match="`rp` must be in a number without a unit"):
        TransitModel(rp=1 * u.R_earth)
