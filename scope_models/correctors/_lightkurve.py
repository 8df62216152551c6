"""lightkurve's arguments and objects: names of masks, options, basis vectors, design matrices."""

import numpy as np

__all__ = ["LightkurveNames", "named_mask", "to_collection", "translated"]

_RENAMED = {"pld_order": "order", "n_pca_terms": "pca_components", "niters": "max_clips"}
_SAME = ("pca_components", "pld_aperture_mask", "background_aperture_mask", "sigma")
_SUCCESSORS = {
    "spline_n_knots": 'the trend has no knots: `trend="gp"` fits its time scale to the data, '
    '`trend="quadratic"` is a polynomial',
    "spline_degree": 'the trend is no spline: choose `trend="gp"` or `trend="quadratic"`',
    "sparse": "matrices are small, as they have only the columns that the data determine: "
    "leave it out",
    "normalize_background_pixels": "the columns of `background` are divided by the star's flux: "
    "leave it out, or pass columns of your own as `regressors`",
    "n_samples": "errors are computed in closed form, without samples: leave it out",
    "use_gp": 'choose `trend="gp"` or `trend="quadratic"`',
    "gp_timescale": 'the time scale of `trend="gp"` is fitted to the data: leave it out',
}
_FOUND = "`print(corrector.result)` and `corrector.result.to_table()` have what the fit found"
_ATTRIBUTES = {
    "dmc": "call `create_design_matrix()`",
    "design_matrix_collection": "call `create_design_matrix()`",
    "X": "call `create_design_matrix()`",
    "coefficients": _FOUND,
    "coefficients_err": _FOUND,
    "diagnose_priors": f"prior widths follow from the data; {_FOUND}",
    "diagnostic_lightcurves": "`diagnose()` draws the systematics and the trend",
    "model_lc": "divide `original_lc` by `corrected_lc`",
    "lc": "it is `original_lc`",
}


class LightkurveNames:
    """Mixin whose errors name what replaces an attribute of lightkurve's corrector."""

    def __getattr__(self, name):
        if name in _ATTRIBUTES:
            raise AttributeError(f"`{name}` is not an attribute here: {_ATTRIBUTES[name]}")
        raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")


def translated(options):
    """Return fields of `Settings` for arguments that `PLDCorrector.correct` does not have itself.

    A TypeError is raised for a name that lightkurve does not have, and a ValueError that names a
    replacement where there is no counterpart.
    """
    found = {}
    for name, value in options.items():
        if name in (*_RENAMED, *_SAME, *_SUCCESSORS) and (value is None or value is False):
            continue  # lightkurve's defaults
        if name in (*_RENAMED, *_SAME):
            found[_RENAMED.get(name, name)] = value
        elif name == "propagate_errors":
            if not value:
                raise ValueError("`propagate_errors` cannot be False: errors are always propagated")
        elif name in _SUCCESSORS:
            raise ValueError(f"`{name}` is not an option here: {_SUCCESSORS[name]}")
        else:
            raise TypeError(f"correct() got an unexpected keyword argument {name!r}")
    return found


def named_mask(tpf, mask, name):
    """Return a mask of pixels for one of lightkurve's names; what is none returns as it is.

    "pipeline", "threshold" (`create_threshold_mask` with 3 standard deviations), "default" (the
    first of these that the file has), "all", "background" (pixels below the median) or "empty".
    Integers are 0 and 1, or the bits of a pipeline. ``name`` is that of the argument in messages.
    """
    if not isinstance(mask, str):
        if isinstance(mask, np.ndarray) and mask.dtype.kind in "iu":
            return mask > 0 if mask.max(initial=0) < 2 else (mask & 2) > 0
        return mask
    if mask == "default":
        mask = "pipeline" if tpf.pipeline_mask.any() else "threshold"
    if mask == "pipeline":
        if not tpf.pipeline_mask.any():
            raise ValueError(f'`{name}` cannot be "pipeline": the file has no such aperture')
        return np.asarray(tpf.pipeline_mask)
    if mask == "threshold":
        return tpf.create_threshold_mask()
    if mask == "background":
        return ~tpf.create_threshold_mask(threshold=0, reference_pixel=None)
    if mask in ("all", "empty"):
        return np.full(tpf.pipeline_mask.shape, mask == "all")
    raise ValueError(
        f'`{name}` must be a mask, None, "pipeline", "threshold", "all", "background" or "empty", '
        f"got {mask!r}"
    )


def to_collection(regressors, prior_variance):
    """Return lightkurve's design matrices of groups of regressors, with their prior variances."""
    from lightkurve.correctors import DesignMatrix, DesignMatrixCollection

    matrices = []
    for g, (name, variance) in enumerate(zip(regressors.names, prior_variance, strict=True)):
        columns = regressors.columns[:, regressors.groups == g]
        sigma = np.full(columns.shape[1], np.sqrt(variance))
        names = [f"{name} {k}" for k in range(columns.shape[1])]
        matrices.append(DesignMatrix(columns, columns=names, name=name, prior_sigma=sigma))
    return DesignMatrixCollection(matrices)
