"""Making a `Target` with one call."""

from scope_models._checks import checked_integer, checked_number, checked_pair
from scope_models.effects.noise import check_seed, fresh_seed
from scope_models.scene.detector import Detector
from scope_models.scene.motion import Motion
from scope_models.scene.star import Star
from scope_models.target._target import Target

__all__ = ["generate_target"]

_NCADENCES = 1000


def generate_target(
    mag=12.0,
    roll=1.0,
    coords=None,
    background_level=None,
    neighbor_magdiff=1.0,
    ncadences=None,
    apsize=7,
    ID=None,
    transit=False,
    variable=False,
    neighbor=False,
    tpf_path=None,
    no_sensitivity_variation=False,
    signal=None,
    *,
    motion=None,
    psf=None,
    detector=None,
    noise=True,
    seed=None,
):
    """
    Simulate a star on a moving detector, as in the paper's Appendix A.

    Parameters
    ----------
    mag : float, optional
        Magnitude in the mission's band (Kp).
    roll : float, optional
        Factor on the motion; 1 is K2's, 0 stands still.
    coords : tuple of float, optional
        Reference position (column, row) in pixels from 0; by default the
        centre of the stamp.
    background_level : float, optional
        Background in e-/s per pixel; by default that of the detector.
    neighbor_magdiff : float, optional
        Magnitude of the neighbour minus `mag`, for ``neighbor=True``.
    ncadences : int, optional
        Number of cadences; by default 1000, or all of a shorter motion.
    apsize : int, optional
        Rows and columns of the stamp; not used with a `detector`.
    ID : int, optional
        EPIC number of a K2 target whose motion is downloaded.
    transit, variable, neighbor : bool, optional
        Add a transit, variability or a neighbour with the defaults of
        `Target.add_transit`, `Target.add_variability` and
        `Target.add_neighbor`.
    tpf_path : str or path-like, optional
        A target pixel or light-curve file whose motion is taken.
    no_sensitivity_variation : bool, optional
        Let all pixels respond alike and evenly, as a control.
    signal : optional
        The star's own relative flux, see `Target.add_signal`.
    motion : `~scope_models.Motion`, optional
        The motion. By default, and without `ID` and `tpf_path`, the
        generated roll of `scope_models.Motion.k2_roll`.
    psf : `~astropy.modeling.Model`, optional
        PSF of the star; by default that of the detector.
    detector : `~scope_models.Detector`, optional
        The detector; by default ``Detector.k2()`` with a stamp of `apsize`.
    noise : bool or iterable of str, optional
        The noise terms, see `~scope_models.simulate`.
    seed : int, optional
        Seed of noise, interpixel map and random positions of neighbours;
        by default a new one, kept as ``Target.seed``.

    Returns
    -------
    `Target`
        The star.

    Raises
    ------
    ValueError
        If an argument is outside its domain, `ncadences` exceeds the length
        of the motion, more than one source of motion is given, or the EPIC
        number is unknown.
    TypeError
        If an option is misspelt or of the wrong kind.
    ConnectionError
        If the motion of an EPIC number cannot be downloaded.

    Warns
    -----
    LostLightWarning
        If the motion takes light off the stamp.

    Examples
    --------
    >>> import scope_models as scope
    >>> star = scope.generate_target(mag=12, ncadences=200, seed=1)
    >>> star.targetpixelfile.shape, star.lightcurve.shape
    ((200, 7, 7), (200,))
    >>> star.add_transit(depth=0.01, per=15, dur=0.5, t0=2).add_neighbor(magdiff=2)
    <Target of magnitude 12 with 1 transit and 1 neighbour: 200 cadences of 7 x 7 pixels, seed 1>
    """
    seed = fresh_seed() if seed is None else check_seed(seed)
    motion = _find_motion(motion, tpf_path, ID, ncadences)
    if detector is None:
        apsize = checked_integer("apsize", apsize, 1)
        detector = Detector.k2(shape=(apsize, apsize))
    elif not isinstance(detector, Detector):
        raise TypeError(f"`detector` must be a Detector, got {detector!r}")
    if background_level is not None:
        detector = detector.replace(background=background_level)
    if no_sensitivity_variation:
        detector = detector.without_sensitivity()
    x_0, y_0 = _reference_position(coords, detector.shape)
    star = Star(mag, x_0, y_0, psf)
    motion = checked_number("roll", roll, any_sign=True) * motion
    target = Target(star, detector, motion, seed=seed, noise=noise)
    if signal is not None:
        target.add_signal(signal)
    if transit:
        target.add_transit()
    if variable:
        target.add_variability()
    if neighbor:
        target.add_neighbor(magdiff=neighbor_magdiff)
    return target


def _find_motion(motion, tpf_path, epic, ncadences):
    """Return the motion of the one source that is given, with the right number of cadences."""
    given = [name for name, value in _sources(motion, tpf_path, epic).items() if value is not None]
    if len(given) > 1:
        raise ValueError(f"only one of `motion`, `tpf_path` and `ID` may be given, got {given}")
    if ncadences is not None:
        ncadences = checked_integer("ncadences", ncadences, 1)
    if not given:
        return Motion.k2_roll(_NCADENCES if ncadences is None else ncadences)
    if tpf_path is not None:
        motion = Motion.from_file(tpf_path)
    elif epic is not None:
        motion = _download_motion(checked_integer("ID", epic, 1))
    elif not isinstance(motion, Motion):
        raise TypeError(f"`motion` must be a Motion, got {motion!r}; `tpf_path` takes a file")
    if ncadences is None:
        ncadences = min(_NCADENCES, len(motion))
    if ncadences > len(motion):
        raise ValueError(
            f"`ncadences` must be at most {len(motion)}, the length of the motion, got {ncadences}"
        )
    return motion[:ncadences]


def _sources(motion, tpf_path, epic):
    return {"motion": motion, "tpf_path": tpf_path, "ID": epic}


def _download_motion(epic):
    """Download the long-cadence target pixel file of a K2 target and return its motion."""
    import lightkurve

    try:
        found = lightkurve.search_targetpixelfile(f"EPIC {epic}", mission="K2", exptime="long")
        tpf = found[0].download(quality_bitmask="none") if len(found) else None
    except (OSError, lightkurve.search.SearchError) as error:
        raise ConnectionError(
            f"the motion of EPIC {epic} could not be downloaded ({type(error).__name__}); without "
            "a network give a target pixel or light-curve file as `tpf_path`, or neither for a "
            "generated motion"
        ) from error
    if tpf is None:
        raise ValueError(f"`ID` must be the EPIC number of a K2 target, {epic} is not known")
    return Motion.from_tpf(tpf)


def _reference_position(coords, shape):
    """Return column and row of the star, the centre of the stamp by default."""
    ny, nx = shape
    if coords is None:
        return (nx - 1) / 2, (ny - 1) / 2
    x_0, y_0 = checked_pair("coords", coords)
    if not (-0.5 <= x_0 <= nx - 0.5 and -0.5 <= y_0 <= ny - 0.5):
        raise ValueError(f"`coords` must be on the stamp of {ny} x {nx} pixels, got {coords!r}")
    return x_0, y_0
