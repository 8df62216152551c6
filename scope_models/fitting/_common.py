"""Positions of the stars of several files, and the common motion of a CCD from them."""

import warnings
from collections import defaultdict
from pathlib import Path

import numpy as np

from scope_models._checks import one_line
from scope_models.exceptions import FitWarning
from scope_models.fitting.fit import fit_tpf
from scope_models.io._light_curves import ccd_name
from scope_models.io.pixels import place_of, read_pixels, usable_positions
from scope_models.scene._tracks import Track, fit_tracks

__all__ = ["common_motion", "common_motions", "pos_corr_track"]

# Prior: map of fitted positions about 1, from errors of the PSF: `_problem._MAP_PRIOR`.
_MAP_ERROR = 0.3
# Prior: what POS_CORR of real files deviates by, pixels, and relative.
_POS_CORR_ERROR, _POS_CORR_SCALE = 0.003, 0.01
# The model of the positions: fast, and of errors that the map takes.
_MODEL = {
    "psf": 1, "positions": "free", "response": "psf", "interpixel": 0.0, "neighbors": "find",
}  # fmt: skip


def common_motion(tpfs):
    """Return the motion of the CCD with the most files; see `scope_models.Motion.from_tpfs`."""
    motions, failed = common_motions(tpfs)
    if not (motions or failed):
        raise ValueError("`tpfs` is empty")
    if not motions:
        raise ValueError(f"no file has positions: {_listed(failed)}")
    label, motion = max(motions.items(), key=lambda item: item[1].meta["n_files"])
    left = failed | dict(motion.meta["left_out"])
    for other in motions:
        if other != label:
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
    tracks, facts, failed = defaultdict(list), {}, {}
    for number, tpf in enumerate(tpfs, start=1):
        path = isinstance(tpf, str | Path)
        name = Path(tpf).name if path else f"file {number}"
        try:
            series = read_pixels(tpf)
            found = _tracks(name, series, pixels=pixels)
        except (OSError, TypeError, ValueError, np.linalg.LinAlgError) as error:
            found, failed[name] = [], one_line(error)
        if found:
            ccd = ccd_name(series.header)
            label = f"{ccd} {86400 * np.nanmedian(np.diff(series.time)):.0f} s".strip()
            tracks[label] += found
            facts[label] = ccd, series.time_format
    motions = {}
    for label, group in tracks.items():
        ccd, time_format = facts[label]
        motion, left = fit_tracks(group, time_format)
        judged = [*zip(group, left, strict=True)]
        used = {track.name for track, out in judged if not out}
        kinds = {track.name: track.kind for track, out in judged if out}
        reasons = {name: f"{kind} disagrees with the other stars" for name, kind in kinds.items()}
        meta = {"ccd": ccd, "n_files": len(used | kinds.keys()), "stars": sorted(used)}
        motions[label] = motion.replace(meta=meta | {"left_out": reasons})
    return motions, failed


def pos_corr_track(name, series):
    """Return the positions of POS_CORR of a star; None without."""
    known = False if series.pos_corr is None else usable_positions(series.pos_corr)
    if not np.any(known):
        return None
    xy = np.where(known[:, None], series.pos_corr, np.nan)
    error, place = np.full(xy.shape, _POS_CORR_ERROR), _place_of(series)
    given = place, series.cadenceno, series.time, xy, error, _POS_CORR_SCALE
    return Track(name, "POS_CORR", *given)


def _place_of(series):
    return place_of(series.header, series.flux.shape[1:]) or (0.0, 0.0)


def _tracks(name, series, *, pixels):
    """Return the positions of a star as its POS_CORR and its pixels have them."""
    tracks = list(filter(None, [pos_corr_track(name, series)]))
    if pixels:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            fit = fit_tpf(series, **_MODEL)
        xy, error = np.stack([fit.x, fit.y], 1), np.stack([fit.x_err, fit.y_err], 1)
        # errors of the noise alone: the scatter about the others gives the rest
        error = error / fit.statistics["error_scale"]
        given = _place_of(series), fit.cadenceno, fit.time, xy, error, _MAP_ERROR
        tracks.append(Track(name, "the position in the pixels", *given))
    return tracks
