"""Fits as FITS files."""

import json
from dataclasses import fields

import numpy as np

from scope_models._arrays import native
from scope_models.effects import PixelShares
from scope_models.fitting.result import FittedStar
from scope_models.io._opening import RefusedError, open_fits
from scope_models.io.tpf import write_hdulist
from scope_models.models import PRF
from scope_models.models._description import describe_model, make_model, packed, unpacked
from scope_models.models._parameters import numbers_of
from scope_models.scene.detector import Detector

__all__ = ["read_fit", "write_fit"]

_CREATOR, _VERSION = "scope_models fit", 2
_COLUMNS = {
    "time": "d",
    "cadenceno": "",
    "quality": "",
    "x": "pixel",
    "x_err": "pixel",
    "y": "pixel",
    "y_err": "pixel",
    "flux": "e-/s",
    "flux_err": "e-/s",
    "flux_scatter": "e-/s",
    "background": "e-/s",
    "background_err": "e-/s",
    "focus": "",
}
_OF_STAR = ("x", "y", "flux", "x_err", "y_err", "flux_err")
_OF_RESPONSE = ("held_out", "outliers")
_IMAGES = ("covariance", "interpixel", "interpixel_err", "observed", "observed_err", "fitted")
_NUMBERS = ("chi2", "n_data", "n_parameters", "error_scale", "converged", "n_steps", "time_format")


def write_fit(fit, path, *, overwrite):
    """Write a fit; the file is there as a whole or not at all."""
    from astropy.io import fits

    primary = fits.PrimaryHDU()
    primary.header["CREATOR"] = _CREATOR
    primary.header["FITVERS"] = (_VERSION, "version of this format")
    columns = []
    for name, unit in _COLUMNS.items():
        values = np.asarray(getattr(fit, name))
        kind = "K" if values.dtype.kind in "iu" else "D"
        columns.append(fits.Column(name.upper(), kind, unit=unit or None, array=values))
    if fit.pos_corr is not None:
        columns += [
            fits.Column(f"POS_CORR{i + 1}", "D", unit="pixel", array=fit.pos_corr[:, i])
            for i in (0, 1)
        ]
    if fit.response:
        columns += [
            fits.Column(name.upper(), "L", array=getattr(fit, name)) for name in _OF_RESPONSE
        ]
    table = fit.table()
    parameters = fits.BinTableHDU(table, name="PARAMETERS")
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
            reason = " ".join(str(error).split())
            raise RefusedError(
                f"{path} holds no fit that can be made: {type(error).__name__}: {reason}"
            ) from error


def _fields_of(hdus):
    """Return the fields of the fit in an HDU list."""
    table = hdus["CADENCES"].data
    values = {"focus": np.ones(len(table))}  # the first version had none
    values |= {
        name: native(table[name.upper()]) for name in _COLUMNS if name.upper() in table.names
    }
    values["pos_corr"] = None
    if "POS_CORR1" in table.names:
        corrections = [native(table[f"POS_CORR{i}"]) for i in (1, 2)]
        values["pos_corr"] = np.column_stack(corrections)
    for name in _OF_RESPONSE:
        if name.upper() in table.names:
            values[name] = native(table[name.upper()]).astype(bool)
    values |= {name: native(hdus[name.upper()].data) for name in _IMAGES}
    cube = native(hdus["NEIGHBORS"].data) if "NEIGHBORS" in hdus else ()
    values["neighbors"] = tuple(FittedStar(*star) for star in cube)
    described = json.loads(native(hdus["DESCRIPTION"].data).astype(np.uint8).tobytes())
    model = _model(described.pop("model"))
    detector = described.pop("detector")
    detector["sensitivity"] = model.sensitivity
    detector["interpixel"] = np.maximum(values["interpixel"], 0.0)
    detector["shape"] = tuple(detector["shape"])
    described["names"] = tuple(described["names"])
    kinds = [model.parameter_kinds.get(name, "other") for name in described["names"]]
    described["kinds"] = tuple(described.get("kinds", kinds))  # the first version had none
    described["at_bounds"] = tuple(described.get("at_bounds", ()))
    described["response"] = tuple(
        PixelShares(**{name: unpacked(value) for name, value in shares.items()})
        for shares in described.get("response", ())
    )
    described["parameters"] = np.array(described["parameters"], dtype=float)
    if described["options"]["interpixel"] is None:
        described["options"]["interpixel"] = np.inf
    return values | described | {"model": model, "detector": Detector(**detector)}


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
        "kinds": list(fit.kinds),
        "at_bounds": list(fit.at_bounds),
        "parameters": fit.parameters.tolist(),
        "options": options,
        "meta": dict(fit.meta),
        "response": [
            {item.name: packed(getattr(shares, item.name)) for item in fields(shares)}
            for shares in fit.response
        ],
        "chi2_held_out": fit.chi2_held_out,
        **{name: getattr(fit, name) for name in _NUMBERS},
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
