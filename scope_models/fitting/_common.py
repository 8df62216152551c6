"""The common motion of the stars of a CCD, from their positions in the pixels and POS_CORR."""

import warnings
from collections import defaultdict
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from scope_models._checks import one_line
from scope_models.exceptions import FitWarning
from scope_models.fitting.fit import fit_tpf
from scope_models.io._light_curves import ccd_name
from scope_models.io.pixels import place_of, read_pixels, usable_positions
from scope_models.scene.common import CommonMotion

__all__ = [
    "Track", "common_motion", "common_motions", "explains", "fit_tracks", "pos_corr_track",
]  # fmt: skip

# Degrees of freedom of Student's t of residuals: a prior for tails.
_TAILS = 4.0
# Most steps, change of the positions that ends them, in their errors, and steps of the noise.
_MOST_STEPS, _SMALL_STEP, _STEPS_OF_NOISE = 60, 0.1, 10
# Standard deviations of maps: of one that is 1, and of fitted positions, by errors of the PSF.
_NO_MAP, _MAP_ERROR = 1e-6, 0.3
# Prior: what POS_CORR of real files deviates by, pixels, and relative.
_POS_CORR_ERROR, _POS_CORR_SCALE = 0.003, 0.01


def common_motion(tpfs):
    """Return the motion of the CCD with the most files, as `Motion.from_tpfs`."""
    motions, left = common_motions(tpfs)
    if not (motions or left):
        raise ValueError("`tpfs` is empty")
    if not motions:
        raise ValueError(f"no file has positions: {_listed(left)}")
    label, motion = max(motions.items(), key=lambda item: item[1].meta["n_files"])
    left = left | dict(motion.meta["left_out"])
    for other in sorted(motions.keys() - {label}):
        left[other] = f"another CCD than {label}, {motions[other].meta['n_files']} files"
    if left:
        what = "left out" if motion.meta["stars"] else "no two stars agree"
        warnings.warn(f"{what}: {_listed(left)}", FitWarning, stacklevel=3)
    if motion.meta["n_files"] == 1:
        message = f"the motion comes from one file of {label}: no other star confirms it"
        warnings.warn(message, FitWarning, stacklevel=3)
    return motion


def _listed(left):
    return "; ".join(f"{name}: {reason}" for name, reason in left.items())


def common_motions(tpfs, *, pixels=True):
    """Return the common motion of each CCD, and the reason for each file without positions."""
    tracks, motions, failed = defaultdict(list), {}, {}
    if isinstance(tpfs, str | Path) or hasattr(tpfs, "flux"):
        tpfs = [tpfs]  # a file could be iterated over, too
    for number, tpf in enumerate(tpfs, start=1):
        name = Path(tpf).name if isinstance(tpf, str | Path) else f"file {number}"
        try:
            series = read_pixels(tpf)
            found = _tracks(name, series, pixels=pixels)
        except (OSError, TypeError, ValueError, np.linalg.LinAlgError) as error:
            failed[name] = one_line(error)
            continue
        if found:
            step = 86400 * np.nanmedian(np.diff(series.time))
            tracks[ccd_name(series.header), f"{step:.0f} s", series.time_format] += found
    for (ccd, step, time_format), group in tracks.items():
        motion, left = fit_tracks(group, time_format)
        pairs = [*zip(group, left, strict=True)]
        reasons = {t.name: f"{t.kind} disagrees with the other stars" for t, out in pairs if out}
        stars = {track.name for track, out in pairs if not out}
        meta = {"ccd": ccd, "n_files": len(stars | reasons.keys()), "stars": sorted(stars)}
        motions[f"{ccd} {step}".strip()] = motion.replace(meta=meta | {"left_out": reasons})
    return motions, failed


def pos_corr_track(name, series):
    """Return the positions of a star by POS_CORR; None without."""
    known = False if series.pos_corr is None else usable_positions(series.pos_corr)
    if not np.any(known):
        return None
    xy = np.where(known[:, None], series.pos_corr, np.nan)
    given = _place_of(series), series.cadenceno, series.time, xy
    return Track(name, "POS_CORR", *given, np.full(xy.shape, _POS_CORR_ERROR), _POS_CORR_SCALE)


def _place_of(series):
    return place_of(series.header, series.flux.shape[1:]) or (0.0, 0.0)


def _tracks(name, series, *, pixels):
    tracks = list(filter(None, [pos_corr_track(name, series)]))
    if pixels:
        with warnings.catch_warnings(action="ignore"):
            fit = fit_tpf(  # fast, and of errors that the map takes
                series, psf=1, positions="free", response="psf", interpixel=0.0, neighbors="find"
            )
        # errors of the noise alone: the scatter about the others gives the rest
        error = np.stack([fit.x_err, fit.y_err], 1) / fit.error_scale
        given = _place_of(series), fit.cadenceno, fit.time, np.stack([fit.x, fit.y], 1), error
        tracks.append(Track(name, "the position in the pixels", *given, _MAP_ERROR))
    return tracks


@dataclass(frozen=True)
class Track:
    """Positions of a star, up to an offset and a linear map."""

    name: str  # of the star
    kind: str  # where its positions are from
    place: tuple  # column and row on the CCD
    cadenceno: np.ndarray  # (n,)
    time: np.ndarray  # (n,), days
    xy: np.ndarray  # (n, 2), px; NaN where unknown
    error: np.ndarray  # (n, 2), px: the least
    map_error: float  # standard deviation of the map about 1


class _Fit:
    """Pointing, roll and scale of each cadence, and the map and the noise of each track.

    Expectation maximization: the states of the cadences are normal about 0, and the residuals of a
    track follow Student's t, with the variance of its errors times a factor of at least 1.
    """

    def __init__(self, tracks):
        self.number = np.unique(np.concatenate([track.cadenceno for track in tracks]))
        n, shape = len(tracks), (len(self.number), 2)
        self.xy, self.precision = np.zeros((2, n, *shape))
        self.time = np.full(shape[0], np.inf)
        for k, track in enumerate(tracks):
            known = np.isfinite(track.xy + track.error).all(axis=1) & np.isfinite(track.time)
            at = np.searchsorted(self.number, track.cadenceno[known])
            self.xy[k, at] = track.xy[known] - np.median(track.xy[known], axis=0)
            self.precision[k, at] = track.error[known] ** -2.0
            self.time[at] = np.minimum(self.time[at], track.time[known])
        self.seen = self.precision[..., 0] > 0
        self.place = np.array([track.place for track in tracks], dtype=float)
        self.center = self.place.mean(axis=0)
        offset = self.place - self.center
        self.size = np.sqrt(np.mean(np.sum(offset**2, axis=1))) or 1.0
        self.arms = self._arms(offset)
        self.given_error = np.array([track.map_error for track in tracks])
        self.map_error, self.maps = self.given_error.copy(), np.zeros((n, 2, 3))
        self.factor, self.tails = np.ones(n), self.seen.astype(float)
        # begin with the median of all tracks
        middle = np.ma.median(np.ma.array(self.xy, mask=self.precision == 0), axis=0).filled(0)
        self.states = np.column_stack([middle, np.zeros_like(middle)])
        self.covariance = np.zeros((len(middle), 4, 4))
        self.prior = np.repeat(np.maximum(np.mean(middle**2, axis=0).max(), 1e-12), 4)
        for k in range(n):
            square = np.mean(self.precision[k] * (self.xy[k] - middle) ** 2, axis=1)[self.seen[k]]
            self.factor[k] = max(np.median(square) / np.log(2), 1.0)  # of an exponential
            self._fit_track(k)

    def _arms(self, offset):
        """Displacements by pointing, roll and scale, ``(k, 2, 4)``."""
        (x, y), one, zero = offset.T / self.size, np.ones(len(offset)), np.zeros(len(offset))
        return np.stack([[one, zero, -y, x], [zero, one, x, y]]).transpose(2, 0, 1)

    def run(self):
        for _ in range(_MOST_STEPS):
            before = self.states
            self.states, self.covariance = self.cadences(np.ones(len(self.xy), dtype=bool))
            variance = np.diagonal(self.covariance, axis1=1, axis2=2)
            self.prior = np.maximum(np.mean(self.states**2 + variance, axis=0), 1e-16)
            for k in range(len(self.xy)):
                self._fit_track(k)
            # the scatter of the maps of a kind, of which the prior counts as one
            maps = self.maps[..., :2]
            square = np.sum((maps - np.eye(2)) ** 2, axis=(1, 2)) / 4
            for error in np.unique(self.given_error):
                kind = self.given_error == error
                self.map_error[kind] = np.sqrt((error**2 + square[kind].sum()) / (1 + kind.sum()))
            # all maps times one matrix are the same model: their priors choose it
            turned = maps.transpose(0, 2, 1) * self.map_error[:, None, None] ** -2.0
            self.maps[..., :2] = maps @ np.linalg.solve((turned @ maps).sum(0), turned.sum(0))
            moved = np.abs(self.states - before)[:, :2] ** 2 / variance[:, :2]
            if np.median(moved) < _SMALL_STEP**2:
                break
        return self

    def cadences(self, used):
        """Return the states, ``(n, 4)``, and their covariance, from some of the tracks."""
        weight = self.tails[used] / self.factor[used, None]
        weight = weight[..., None] * self.precision[used]  # (k, n, 2)
        rows = self.maps[used, :, :2] @ self.arms[used]  # (k, 2, 4)
        squares = np.einsum("kai,kaj->kaij", rows, rows)
        normal = np.einsum("kna,kaij->nij", weight, squares, optimize=True)
        moved = weight * (self.xy - self.maps[:, None, :, 2])[used]
        right = np.einsum("kna,kai->ni", moved, rows, optimize=True)
        covariance = np.linalg.inv(normal + np.diag(1 / self.prior))
        return (covariance @ right[..., None])[..., 0], covariance

    def _regress(self, k, states, covariance, map_error, tails, factor):
        """Return map and origin of a track, its squared residuals, and the evidence's prior."""
        arms, xy, prior = self.arms[k], self.xy[k], map_error**-2.0
        design = np.column_stack([states @ arms.T, np.ones(len(states))])
        spread = arms @ covariance @ arms.T
        weight = tails[:, None] * self.precision[k] / factor
        normal = design.T @ (weight.T[..., None] * design)
        normal[:, :2, :2] += np.tensordot(weight, spread, axes=(0, 0))
        cross = normal[:, :2, 2:]
        marginal = normal[:, :2, :2] - cross * cross.transpose(0, 2, 1) / normal[:, 2:, 2:]
        normal[:, [0, 1], [0, 1]] += prior
        right = (weight * xy).T @ design + prior * np.eye(2, 3)
        found = np.linalg.solve(normal, right[..., None])[..., 0]
        slopes = found[:, :2]
        evidence = np.linalg.slogdet(np.eye(2) + marginal / prior)[1].sum()
        evidence += prior * np.sum((slopes - np.eye(2)) ** 2)
        products = slopes[:, :, None] * slopes[:, None]
        rest = (xy - design @ found.T) ** 2 + np.tensordot(spread, products, ((1, 2), (1, 2)))
        return found, np.sum(rest * self.precision[k], axis=1), -evidence / 2

    def _fit_track(self, k):
        given = self.states, self.covariance, self.map_error[k], self.tails[k], self.factor[k]
        self.maps[k], squares, _ = self._regress(k, *given)
        self.factor[k], self.tails[k] = self._noise(k, squares, self.factor[k])

    def _noise(self, k, squares, factor):
        seen = self.seen[k]
        tails = np.where(seen, (_TAILS + 2) / (_TAILS + squares / factor), 0.0)
        return max(np.sum(tails * squares) / (2 * seen.sum()), 1.0), tails

    def agrees(self, k, states, covariance):
        """Whether a motion explains a track better than noise alone, or within its errors."""
        moved, _ = self._evidence(k, states, covariance, self.map_error[k])
        alone, _ = self._evidence(k, 0 * states, 0 * covariance, self.map_error[k])
        return moved > alone or self._evidence(k, states, covariance, _NO_MAP)[1] <= 1

    def _evidence(self, k, states, covariance, map_error):
        """Return the logarithm of the evidence of a track, and the factor of its variance."""
        factor, tails = self.factor[k], self.tails[k]
        for _ in range(_STEPS_OF_NOISE):
            _, squares, prior = self._regress(k, states, covariance, map_error, tails, factor)
            factor, tails = self._noise(k, squares, factor)
        density = -np.log(factor) - (_TAILS / 2 + 1) * np.log1p(squares / (_TAILS * factor))
        return density[self.seen[k]].sum() + prior, factor

    def motion(self, time_format):
        light = np.einsum("kn,kna->k", self.tails / self.factor[:, None], self.precision)
        middle, known = light @ self.place / light.sum(), self.seen.any(axis=0)
        # x, y, roll and scale
        matrix = np.vstack([self._arms((middle - self.center)[None])[0], np.eye(4)[2:] / self.size])
        values = dict(zip(CommonMotion.offsets_of, matrix @ self.states[known].T, strict=True))
        variance = np.diagonal(matrix @ self.covariance[known] @ matrix.T, axis1=1, axis2=2)
        values |= dict(zip(CommonMotion.errors_of, np.sqrt(variance).T, strict=True))
        values |= {"time": self.time[known], "cadenceno": self.number[known]}
        return CommonMotion(**values, time_format=time_format, place=tuple(middle))


def fit_tracks(tracks, time_format="bkjd"):
    """Return the common motion of stars of a CCD, and which tracks the other stars disagree with.

    These do not count, unless all are so.
    """
    fit, names = _Fit(tracks).run(), np.array([track.name for track in tracks])
    others = [names != name for name in names]
    agree = [not o.any() or fit.agrees(k, *fit.cadences(o)) for k, o in enumerate(others)]
    if any(agree) and not all(agree):
        fit = _Fit([track for track, good in zip(tracks, agree, strict=True) if good]).run()
    return fit.motion(time_format), [not good for good in agree]


def explains(motion, track, series):
    """Whether a motion explains the track of the star of a `PixelSeries`."""
    moved, error = motion.offsets(series)
    known = np.isfinite(moved)
    fit = _Fit([replace(track, xy=np.where(known, track.xy, np.nan))])
    states, covariance = np.zeros((len(moved), 4)), np.zeros((len(moved), 4, 4))
    states[:, :2] = np.where(known, moved, 0)
    covariance[:, [0, 1], [0, 1]] = np.where(known, error, 0) ** 2
    return fit.agrees(0, states, covariance)
