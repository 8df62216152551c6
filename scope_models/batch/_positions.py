"""Positions of stars of a run from other stars of their CCDs."""

import hashlib
import warnings
from collections import defaultdict
from pathlib import Path

from scope_models.exceptions import DetrendingWarning, FitWarning
from scope_models.fitting._common import common_motions, pos_corr_track
from scope_models.io import read_pixels
from scope_models.io._hlsp import ccd_label, sha256
from scope_models.io._opening import cards_of
from scope_models.scene import Motion
from scope_models.scene._tracks import explains

__all__ = ["file_cards", "star_positions", "write_motions"]

# Files of a CCD whose POS_CORR give the motion of its other stars: a limit of time.
_MOST = 12
# Folder of the motions, and stars at least that outvote another one.
_FOLDER, _MAJORITY = "positions", 3
# All cards would take longer, for all files of a run before the first is corrected.
_KEYWORDS = (
    "MISSION", "TELESCOP", "OBJECT", "CAMPAIGN", "QUARTER", "SECTOR", "CHANNEL", "CAMERA", "CCD",
    "TIMEDEL",
)  # fmt: skip


def write_motions(files, folder, positions_from=None):
    """Write the common motion of each CCD; return what the task of each file has of it.

    The motion is that of ``positions_from``, from their pixels and POS_CORR, for all files of their
    CCDs; else that of POS_CORR of some of the files, for those whose own is missing or disagrees.
    """
    given, groups, written = positions_from is not None, defaultdict(list), {}
    places = [_place(file) for file in files]
    sources = positions_from if given else files
    for file, place in zip(sources, map(_place, sources) if given else places, strict=True):
        groups[place].append(file)
    if others := set(groups) - set(places):
        text = f"no file of the run is of the same CCD as {groups[min(others)][0]}"
        warnings.warn(text, FitWarning, stacklevel=3)
    for place in set(groups) & set(places):
        name = "-".join(filter(None, place)) or "motion"
        if given:  # stars with the motion of others, or of other contents, are corrected again
            contents = sorted((Path(file).name, sha256(file)) for file in groups[place])
            name += f"-{hashlib.sha256(repr(contents).encode()).hexdigest()[:8]}"
        path = Path(folder) / _FOLDER / f"{name}.fits"
        if path.exists() or _write_motion(path, place, groups[place], given=given):
            written[place] = f"{_FOLDER}/{path.name}"
    return [{"positions": written.get(place, "")} if written else {} for place in places]


def _write_motion(path, place, files, *, given):
    """Write the common motion of a CCD; return whether there is one."""
    few = files[:: max(-(-len(files) // _MOST), 1)]
    if given:
        motion = Motion.from_tpfs(files)
    elif len(few) > 1 and all(place[:2]) and (found := common_motions(few, pixels=False)[0]):
        motion = max(found.values(), key=lambda motion: motion.meta["n_files"])
    else:
        return False
    path.parent.mkdir(parents=True, exist_ok=True)
    motion.replace(meta={**motion.meta, "given": given}).write(path, overwrite=True)
    return True


def _place(file):
    """Return campaign, CCD and length of the cadences of a file, as its headers have them."""
    cards = file_cards(file)
    step = cards.get("TIMEDEL")
    return *ccd_label(cards), f"{86400 * step:.0f}s" if isinstance(step, float) else ""


def star_positions(tpf, path):
    """Return the motion of a CCD for a star; None if its own positions agree with it."""
    motion, series = Motion.read(path), read_pixels(tpf)
    stars = f"{len(motion.meta['stars'])} stars of {motion.meta['ccd'] or 'the same CCD'}"
    if motion.meta["given"]:
        warnings.warn(f"positions come from {stars}", DetrendingWarning, stacklevel=2)
        return motion
    try:
        motion.offsets(series)
    except ValueError:  # it has none of the cadences
        return None
    track = pos_corr_track("", series)
    if not motion.meta["stars"]:  # they disagree
        return None
    if track is None:
        message = f"POS_CORR is missing: positions come from {stars}"
    else:
        outvoted = len(motion.meta["stars"]) >= _MAJORITY
        if not outvoted or explains(motion, track, series):
            return None
        message = f"POS_CORR disagrees with that of other stars: positions come from {stars}"
    warnings.warn(message, DetrendingWarning, stacklevel=2)
    return motion


def file_cards(file):
    """Return the cards that name a target pixel file; none of one that cannot be read."""
    from astropy.io import fits
    from astropy.utils.data import get_readable_fileobj

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with get_readable_fileobj(file, encoding="binary") as stream:
                headers = [fits.Header.fromfile(stream) for _ in range(2)]
                return cards_of(*({key: h[key] for key in _KEYWORDS if key in h} for h in headers))
    except (OSError, ValueError, IndexError, EOFError, fits.VerifyError):
        return {}
