"""What a correction found, in numbers."""

from dataclasses import dataclass, field

import numpy as np
from astropy.table import Table

__all__ = ["PLDResult", "make_result"]

_TRANSIT_HOURS = 6.5


@dataclass(frozen=True, eq=False)
class PLDResult:
    """
    Hyper-parameters and diagnostics of a call of `PLDCorrector.correct`.

    All variances are of relative flux.

    Parameters
    ----------
    groups : tuple of str
        Names of the groups of regressors: ``"order 1"``, ``"order 2"``, ``"order 2, shared"``,
        ..., ``"segments"``, ``"background"``, ``"neighbors"``.
    n_columns : tuple of int
        Number of columns of each group.
    prior_variance : tuple of float
        Prior variance of each group's coefficients.
    explained_variance : tuple of float
        Variance of each group's part of the model. The parts are correlated: the variance of
        their sum can be smaller.
    effective_parameters : tuple of float
        Number of parameters per group that the data determine.
    noise_scale : float
        Fitted variance of the white noise over FLUX_ERR squared. Above one there is more noise
        than FLUX_ERR says; below one the model has removed noise of pixels with little light.
    jitter : float
        White noise (standard deviation, relative flux) that adds to FLUX_ERR in quadrature;
        zero if ``noise_scale`` is not above one.
    trend_sigma, trend_period : float
        Standard deviation and undamped period (days) of the long-term Gaussian process; NaN
        with ``trend="quadratic"``.
    log_likelihood : float
        Logarithm of the marginal likelihood of the relative flux' logarithm.
    n_used, n_outliers : int
        Number of cadences in the fit, and of those left out as outliers.
    transit_survival : float
        Part of a transit's depth that survives the correction if the transit is not masked:
        1 minus what the regressors take out of a box of ``window`` cadences, averaged over all
        positions.
    window : int
        Number of cadences in 6.5 hours, 13 for long cadences.
    breaks : tuple of float
        Times (days) at which segments begin.
    transit_scale, transit_scale_err : float
        Amplitude of the jointly fitted transit model (1: as given), NaN without one.

    Examples
    --------
    >>> from scope_models import Detector, Motion, Star, simulate
    >>> from scope_models.correctors import PLDCorrector
    >>> observation = simulate(Star(12.0), Detector.k2(), Motion.k2_roll(300), seed=1)
    >>> corrector = PLDCorrector(observation.to_tpf())
    >>> corrected = corrector.correct()
    >>> corrector.result.groups[:2]
    ('order 1', 'order 2')
    """

    groups: tuple
    n_columns: tuple
    prior_variance: tuple
    explained_variance: tuple
    effective_parameters: tuple
    noise_scale: float
    jitter: float
    trend_sigma: float
    trend_period: float
    log_likelihood: float
    n_used: int
    n_outliers: int
    transit_survival: float
    window: int
    breaks: tuple = ()
    transit_scale: float = field(default=np.nan)
    transit_scale_err: float = field(default=np.nan)

    def to_table(self):
        """
        Return one row per group of regressors, and the rest as metadata.

        Returns
        -------
        `~astropy.table.Table`
            Columns ``group``, ``n_columns``, ``prior_variance``, ``explained_variance`` and
            ``effective_parameters``.
        """
        names = ("n_columns", "prior_variance", "explained_variance", "effective_parameters")
        table = Table({"group": list(self.groups), **{n: list(getattr(self, n)) for n in names}})
        skip = {"groups", *names}
        table.meta.update({k: v for k, v in vars(self).items() if k not in skip})
        return table


def make_result(solution, breaks, *, n_outliers, transit):
    """Return the numbers of a solution; the last flat column is a transit if ``transit``."""
    hyper, regressors = solution.hyper, solution.regressors
    window = round(_TRANSIT_HOURS / 24 / float(np.median(np.diff(solution.time))))
    window = int(np.clip(window, 1, len(solution.alpha) // 2))
    excess = max(hyper.noise_scale - 1, 0.0) * np.median(solution.variance)
    scale, scale_err = solution.flat_coefficient(-1) if transit else (np.nan, np.nan)
    process = hyper.amplitude is not None
    return PLDResult(
        groups=regressors.names,
        n_columns=tuple(int(k) for k in np.bincount(regressors.groups)),
        prior_variance=tuple(float(v) for v in hyper.variances),
        explained_variance=tuple(solution.group_variances()),
        effective_parameters=tuple(float(v) for v in solution.effective_parameters()),
        noise_scale=hyper.noise_scale,
        jitter=float(np.sqrt(excess)),
        trend_sigma=float(np.sqrt(hyper.amplitude)) if process else np.nan,
        trend_period=hyper.period if process else np.nan,
        log_likelihood=solution.log_likelihood,
        n_used=int(solution.use.sum()),
        n_outliers=n_outliers,
        transit_survival=solution.survival(window),
        window=window,
        breaks=breaks,
        transit_scale=scale,
        transit_scale_err=scale_err,
    )
