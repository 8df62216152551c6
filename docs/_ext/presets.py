"""Write the table of the detectors' presets for the page on noise."""

import csv
from dataclasses import fields

from astropy.modeling import Model

from scope_models import Detector
from scope_models.scene.presets import PRESETS

UNITS = {
    "shape": "rows, columns",
    "zero_point": "e-/s",
    "zero_point_mag": "mag",
    "int_time": "s",
    "pixel_scale": "arcsec",
    "read_time": "s",
    "gain": "e-/DN",
    "read_noise": "e-/read",
    "background": "e-/s/px",
    "well_depth": "e-",
    "fixed_offset": "DN",
    "mean_black": "DN",
}


def write_presets(path):
    """Write one row per field, with the values of each preset as the code has them."""
    detectors = {f'"{name}"': Detector.preset(name) for name in PRESETS}
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["Field", "Unit", *detectors])
        for item in fields(Detector):
            if item.name == "mission":
                continue
            values = [_text(getattr(detector, item.name)) for detector in detectors.values()]
            writer.writerow([f"``{item.name}``", UNITS.get(item.name, ""), *values])
        for name, unit in (("exposure_time", "s"), ("cadence_days", "d")):
            values = [f"{getattr(detector, name):.7g}" for detector in detectors.values()]
            writer.writerow([f"*{name}*", unit, *values])


def _text(value):
    """Return a value as a cell of the table."""
    if isinstance(value, Model):
        return _describe(value)
    if isinstance(value, tuple):
        return ", ".join(getattr(item, "name", str(item)) for item in value)
    return f"{value:.12g}" if isinstance(value, float) else str(value)


def _describe(model):
    """Return the numbers of a PSF or of a sensitivity."""
    if hasattr(model, "left"):
        return f"{_describe(model.left)}, {_describe(model.right)}"
    if hasattr(model, "x_coefficients"):
        return "; ".join(
            " ".join(f"{number:g}" for number in numbers)
            for numbers in (model.x_coefficients, model.y_coefficients)
        )
    return f"{model.flux.value:g} with sigma {model.sigma_x.value:g} px"
