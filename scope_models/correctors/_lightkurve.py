"""lightkurve's arguments and objects: names of masks, options, basis vectors, design matrices."""

from numbers import Real
from os import PathLike

import numpy as np

from scope_models._arrays import plain_array

__all__ = [
    "LightkurveNames",
    "external_columns",
    "named_mask",
    "sorted_regressors",
    "to_collection",
    "translated",
]

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


def sorted_regressors(regressors):
    """Sort what `PLDCorrector.correct` takes as regressors, one or a list of them.

    Returns whether the pixels outside of the aperture are among them, target pixel files, and all
    that has a row per cadence; numbers are one column.
    """
    listed = isinstance(regressors, list | tuple)
    several = listed and not any(isinstance(one, Real) for one in regressors)
    background, others, columns = False, [], []
    for one in regressors if several else [regressors]:
        if isinstance(one, str) and one == "background":
            background = True
        elif hasattr(one, "flux") or isinstance(one, (str, PathLike)):
            others.append(one)
        else:
            columns.append(one)
    return background, others, columns


def external_columns(regressors, cadenceno):
    """Return columns of the user's own with unit variance, NaN where a column is unknown.

    Basis vectors are matched by their cadence numbers; arrays, design matrices and collections
    of them must have a row per cadence.
    """
    columns = np.concatenate([_columns_of(one, cadenceno) for one in regressors], axis=1)
    spread = np.nanstd(columns, axis=0)
    varies = spread > 0
    return columns[:, varies] / spread[varies]


def _columns_of(regressor, cadenceno):
    n = len(cadenceno)
    if hasattr(regressor, "cbv_indices"):
        number, vectors = np.asarray(regressor["CADENCENO"]), regressor.cbv_indices
        vectors = [plain_array(regressor[f"VECTOR_{k}"], "", "regressors") for k in vectors]
        _, here, there = np.intersect1d(cadenceno, number, return_indices=True)
        if not len(here):
            raise ValueError("`regressors` must share cadences with the target, got none")
        columns = np.full((n, len(vectors)), np.nan)
        columns[here] = np.stack(vectors, axis=1)[there]
        columns[here[np.asarray(regressor["GAP"], dtype=bool)[there]]] = np.nan
        return columns
    values = regressor.values if hasattr(regressor, "prior_sigma") else regressor
    columns = plain_array(values, "", "regressors")
    columns = columns[:, None] if columns.ndim == 1 else columns
    if columns.ndim != 2 or len(columns) != n:
        raise ValueError(f"`regressors` must have {n} rows, got shape {columns.shape}")
    return columns


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
