"""Scenes: stars, a detector and a motion, all that a simulation starts from."""

import warnings
from collections.abc import Callable, Mapping
from dataclasses import KW_ONLY, dataclass, field
from functools import cache, partial
from types import MappingProxyType

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from astropy.modeling import Model
from astropy.table import Table
from astropy.time import Time

from scope_models._arrays import plain_array, plain_number, plain_time
from scope_models._checks import check_fields, checked_matrix, checked_model, integer, number
from scope_models._docstrings import documented
from scope_models._values import Value, frozen, html_table
from scope_models.effects import Effect, mission_effects
from scope_models.effects._noise import noise_terms
from scope_models.effects.base import checked_several
from scope_models.exceptions import CatalogWarning
from scope_models.io import TPFMetadata
from scope_models.io._headers import tan_projection
from scope_models.missions import MISSIONS, TIME_ZEROS
from scope_models.models import PRF, PRFGrid
from scope_models.models._description import check_coord, sky_place
from scope_models.models._series import unit_images
from scope_models.scene import _storage
from scope_models.scene.catalog import star_counts
from scope_models.scene.detector import Detector
from scope_models.scene.motion import Motion

__all__ = ["Scene", "Star"]

_SAME = 0.1  # deg
_KINDS = {"detector": (Detector, "a Detector"), "motion": (Motion, "a Motion")}
_KINDS |= {"object_name": (str | None, "text"), "metadata": (Mapping, "a mapping")}
# Names of columns, in lower case, in order of preference.
_RA, _DEC = ("ra", "ra_icrs", "raj2000", "_raj2000"), ("dec", "de_icrs", "dej2000", "_dej2000")
_PROPER_MOTIONS = (("pmra", "pm_ra_cosdec"), ("pmdec", "pmde", "pm_dec"))
_EPOCH = ("ref_epoch", "epoch")
_MAGNITUDES = {
    "Kp": ("kp", "kpmag", "kepmag", "k2mag"),
    "T": ("tmag", "tessmag", "t"),
    "R": ("rmag", "r"),
}
_ANY_MAGNITUDE = ("mag", "magnitude", "phot_g_mean_mag", "gmag")
_FARTHEST = 200.0  # px beyond the stamp
_MARGIN = 20  # px about the stamp in which faint stars are drawn
# A star outside matters if it adds this part of a dark pixel's noise to any pixel.
_LEAST_NOISE = 0.01
_PSF_BLOCK = 64  # px in which the PSF is taken as the same
_BATCH = 64
_BRIGHTEST = 5.0
# Header cards on the star and on the place of the stamp.
_IDENTITY = ("target_id", "object_name", "ra", "dec", "orientation", "matrix", "column", "row")


@dataclass(frozen=True, eq=False, repr=False)
class Star(Value):
    """A star on the stamp.

    Parameters
    ----------
    mag : float or Quantity
        Magnitude in the mission's band (Kp or T).
    x_0, y_0 : float, Quantity or None, optional
        Column and row of the reference position on the stamp, pixels from 0; None is its center.
    psf : astropy.modeling.Model or None, optional
        A density with the parameters flux, x_0 and y_0, as photutils' PSFs, or a sum of several,
        scaled to a total flux of 1, with the first component at the star's position. None takes
        the detector's PSF.
    signal : astropy.modeling.Model or callable or array_like or None, optional
        Mean relative flux of each cadence: a one-dimensional model or a function of time (days),
        or one number per cadence. None is constant.
    coord : SkyCoord or None, optional
        Place on the sky, in place of ``x_0`` and ``y_0``; of the target the place that the stamp
        looks at. With a proper motion it needs an ``obstime``, and is moved to the middle of the
        scene's motion.

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind or outside its domain.

    Examples
    --------
    >>> from scope_models import Star
    >>> Star(12.0, 5.1, 4.9, signal=lambda time: 1 - 0.01 * (time > 1)).relative_flux([0.5, 1.5])
    array([1.  , 0.99])
    """

    mag: float = number(unit=u.mag, any_sign=True)
    x_0: float | None = number(None, u.pix, any_sign=True)
    y_0: float | None = number(None, u.pix, any_sign=True)
    psf: "Model | None" = None
    signal: "Model | Callable | np.ndarray | None" = None
    coord: SkyCoord | None = None

    def __post_init__(self):
        put = object.__setattr__
        check_fields(self)
        put(self, "psf", checked_model("psf", self.psf))
        if self.psf is not None:
            PRF(self.psf)  # fails if it cannot be integrated over pixels
        put(self, "signal", _checked_signal(self.signal))
        if self.coord is not None:
            check_coord(self.coord)

    def relative_flux(self, time):
        """Return the relative flux of each cadence.

        Parameters
        ----------
        time : array_like or Quantity of shape (n,)
            Middle of each cadence, days.

        Returns
        -------
        ndarray of shape (n,)
            1 is the star's magnitude.

        Raises
        ------
        ValueError
            If the signal has another length, or is negative or not finite.
        """
        time = plain_time(time, None, "time")
        if self.signal is None:
            return np.ones(time.shape)
        signal = self.signal(time) if callable(self.signal) else self.signal
        signal = np.array(plain_array(signal, u.one, "signal"))
        if signal.shape != time.shape:
            wanted = f"one number for each of the {len(time)} cadences"
            raise ValueError(f"`signal` must give {wanted}, got the shape {signal.shape}")
        return _check_values(signal)


@dataclass(frozen=True, eq=False, repr=False)
class Scene(Value):
    """All that a simulation starts from.

    ``simulate(scene)`` gives its pixels, as does ``simulate(*scene, **scene.options)``; `replace`
    gives a new scene.

    Parameters
    ----------
    stars : Star or sequence of Star
        The stars; the first is the target.
    detector : Detector
        The pixels.
    motion : Motion
        The motion that all stars share.
    seed : int, optional
        The seed of the interpixel map and of all noise; None takes a new one in each simulation.
    noise : bool or str or iterable of str, optional
        Names out of "photon", "background", "read" and "quantization"; True for the first three,
        False for none.
    n_sub : int, optional
        Exposures within a cadence over which the motion is averaged, along straight lines between
        the middles of the cadences.
    effects : Effect or sequence of Effect or "mission", optional
        Effects besides noise, saturation and the detector's own, in any order: see
        `scope_models.effects`. "mission" are `~scope_models.effects.mission_effects`.
    target_id : int, optional
        KEPLERID or TICID of the target in a file; the default is 1.
    object_name : str, optional
        Name of the target in a file; the default is "SIM" and the number.
    ra, dec : float or Quantity, optional
        Place of the target on the sky, deg (ICRS); by default the middle of a field of the mission.
    orientation : float or Quantity, optional
        Position angle of the direction of growing rows, deg from north to east.
    matrix : tuple of float, optional
        PC1_1, PC1_2, PC2_1 and PC2_2 of the projection, in place of ``orientation``.
    column, row : int, optional
        Detector column and row of the stamp's first pixel.
    metadata : mapping, optional
        Further fields of `~scope_models.io.TPFMetadata`, as campaign or channel.

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind or outside its domain.

    Examples
    --------
    >>> from scope_models import Detector, Motion, Scene, Star
    >>> scene = Scene(Star(12.0), Detector.k2(), Motion.still(10), seed=1)
    >>> scene  # it unpacks as stars, detector, motion
    <Scene of 1 star, K2, 10 cadences of 11 x 11 pixels, seed 1>
    >>> scene.replace(seed=2).seed
    2
    """

    stars: tuple[Star, ...]
    detector: Detector
    motion: Motion
    _: KW_ONLY
    seed: int | None = integer(None, 0)
    noise: frozenset = True
    n_sub: int = integer(1, 1)
    effects: tuple[Effect, ...] = ()
    target_id: int | None = integer(None, 1)
    object_name: str | None = None
    ra: float | None = number(None, "deg", any_sign=True)
    dec: float | None = number(None, "deg", any_sign=True, at_most=90)
    orientation: float | None = number(None, "deg", any_sign=True)
    matrix: tuple[float, ...] | None = field(default=None, metadata={"check": checked_matrix})
    column: int | None = integer(None, 0)
    row: int | None = integer(None, 0)
    metadata: Mapping = field(default_factory=dict)

    def __post_init__(self):
        put = partial(object.__setattr__, self)
        put("stars", checked_several("stars", self.stars, Star))
        if not self.stars:
            raise ValueError("`stars` must hold at least one star")
        for name, (kind, wanted) in _KINDS.items():
            if not isinstance(getattr(self, name), kind):
                raise TypeError(f"`{name}` must be {wanted}, got {getattr(self, name)!r}")
        put("noise", noise_terms(self.noise))
        check_fields(self)
        own = isinstance(self.effects, str) and self.effects == "mission"
        effects = mission_effects(self.detector) if own else self.effects
        put("effects", checked_several("effects", effects, Effect))
        self._put_on_sky()
        put("metadata", MappingProxyType(dict(self.metadata)))

    def __iter__(self):
        return iter((self.stars, self.detector, self.motion))

    def __getitem__(self, index):
        return tuple(self)[index]

    def __repr__(self):
        ny, nx = self.detector.shape
        stars = f"{len(self.stars)} star{'' if len(self.stars) == 1 else 's'}"
        name = "" if self.object_name is None else f" {self.object_name}"
        seed = "" if self.seed is None else f", seed {self.seed}"
        return (
            f"<Scene{name} of {stars}, {self.detector.mission}, {len(self.motion)} cadences of "
            f"{ny} x {nx} pixels{seed}>"
        )

    def _repr_html_(self):
        rows = {"detector": repr(self.detector), "motion": repr(self.motion)}
        for i, (star, (x, y)) in enumerate(zip(self.stars, self.positions, strict=True), 1):
            rows[f"star {i}"] = f"magnitude {star.mag:g} at column {x:g}, row {y:g}"
        return html_table(repr(self), rows)

    def _put_on_sky(self):
        """Take the sky position of the target, and check those of all stars."""
        if self.stars[0].coord is not None:
            place = sky_place(self.stars[0].coord, _middle_year(self.motion))
            for name, value in zip(("ra", "dec"), place, strict=True):
                given = getattr(self, name)
                # A scene that is replaced has the place of another time.
                if given is not None and abs(given - value) > _SAME:
                    raise ValueError(f"`{name}` must not be given for a target with a `coord`")
                object.__setattr__(self, name, value)
        for star in self.stars[1:]:
            if star.coord is not None and (star.x_0, star.y_0) != (None, None):
                raise ValueError("`coord` must not be given together with `x_0` or `y_0`")

    @property
    def options(self):
        """Fields beside stars, detector and motion that are not their defaults, and the seed."""
        options = {"seed": self.seed, "noise": sorted(self.noise), "n_sub": self.n_sub}
        options |= {"effects": self.effects} if self.effects else {}
        options |= _identity(self)
        return options | ({"metadata": dict(self.metadata)} if self.metadata else {})

    @property
    def positions(self):
        """Reference position (x_0, y_0) of each star, pixels; shape (n_stars, 2)."""
        found = _places(self)
        on_sky = [i for i, star in enumerate(self.stars) if i and star.coord is not None]
        if on_sky:
            places = [sky_place(self.stars[i].coord, _middle_year(self.motion)) for i in on_sky]
            found[on_sky] = self.wcs.wcs_world2pix(places, 0)
        return found

    @property
    def wcs(self):
        """World coordinates of the stamp, the `~astropy.wcs.WCS` that its files have."""
        from astropy.wcs import WCS

        metadata = TPFMetadata.of(self.detector, **scene_facts(self))
        return WCS(tan_projection(metadata, self.detector.shape))

    @classmethod
    def from_catalog(
        cls, table, coord, detector, motion, *, target=None, orientation=0.0, wcs=None,
        magnitude=None, magnitude_limit=None, background_stars=None, ref_epoch=None, psf=None,
        **fields,
    ):  # fmt: skip
        """Return the scene of a star and its neighbors on the sky.

        Parameters
        ----------
        table : astropy.table.Table, mapping or None
            The catalog, or None: columns ``ra`` and ``dec`` (deg, ICRS), a magnitude, and if wanted
            proper motions ``pmra`` (times the cosine of the declination) and ``pmdec``, mas/yr,
            and their ``ref_epoch`` (Julian year). Names of Gaia, VizieR and the missions' catalogs
            are found. Missing proper motions are 0.
        coord : SkyCoord
            Place of the target at the time of the motion.
        detector : Detector
            The pixels.
        motion : Motion
            The motion that all stars share. Proper motions move stars to its middle.
        target : Star, optional
            The target, with its signal, in place of the star of the table within a pixel of
            ``coord``; its ``x_0`` and ``y_0`` are where ``coord`` is.
        orientation : float or Quantity, optional
            Position angle of the direction of growing rows, deg from north to east.
        wcs : astropy.wcs.WCS, optional
            World coordinates of the stamp, in place of ``orientation``, the target's place and the
            pixel scale; distortions are left out.
        magnitude : str, optional
            Column of the magnitudes; by default the mission's band, else ``mag``, else Gaia's G.
        magnitude_limit : float or Quantity, optional
            Fainter stars of the table are left out.
        background_stars : float or Quantity, optional
            Draw stars of `~scope_models.scene.catalog.star_counts` down to this magnitude, fainter
            than those of the table, at random places of the ``seed``.
        ref_epoch : float, Quantity or Time, optional
            Epoch of the table's places, Julian year, if it has no column of it.
        psf : astropy.modeling.Model, PRFGrid or callable, optional
            PSF of all stars, PRFs of several places, or a function of detector column and row that
            returns a model, for blocks of 64 by 64 pixels.
        **fields
            Other fields of `Scene`, as ``seed``, ``column`` and ``row``.

        Returns
        -------
        Scene
            The target, all stars on the stamp, and those outside that add more than 1 % of the
            noise of a dark pixel to any pixel.

        Raises
        ------
        TypeError, ValueError
            If an argument is of the wrong kind or outside its domain, the table lacks a column or
            has no star at ``coord``, or ``wcs`` is of another field.

        Warns
        -----
        CatalogWarning
            If stars of the table without a place or a magnitude are left out.

        Examples
        --------
        >>> from astropy.coordinates import SkyCoord
        >>> from scope_models import Detector, Motion, Scene
        >>> table = {"ra": [40.0, 40.003], "dec": [-20.0, -20.0], "mag": [12.0, 14.5]}
        >>> coord = SkyCoord(40.0, -20.0, unit="deg")
        >>> len(Scene.from_catalog(table, coord, Detector.k2(), Motion.still(3)).stars)
        2
        """
        check_coord(coord)
        year = _middle_year(motion)
        places, mags = _read_catalog(table, detector.mission, magnitude, ref_epoch, year)
        found = _find_target(coord, target, places, mags, detector.pixel_scale)
        coord, target, places, mags = found
        if wcs is not None:
            place, scale, fields["matrix"] = _star_frame(coord, detector.shape, wcs)
            detector = detector.replace(pixel_scale=scale)
            target = target.replace(x_0=place[0], y_0=place[1])
        if hasattr(psf, "param_names"):
            detector, psf = detector.replace(psf=psf), None
        ra, dec = coord.icrs.ra.deg, coord.icrs.dec.deg
        base = cls(target, detector, motion, ra=ra, dec=dec, orientation=orientation, **fields)
        stars = _place_stars(base, places, mags, magnitude_limit, background_stars, psf)
        return base.replace(stars=stars)

    @documented()
    def plot(self, ax=None):
        """Draw the stamp with the track of the target and the places of the other stars.

        Parameters
        ----------
        {draw}

        Examples
        --------
        >>> from scope_models import Detector, Motion, Scene, Star
        >>> Scene(Star(12.0), Detector.k2(), Motion.k2_roll(50)).plot().get_xlabel()
        'Column (pixel)'
        """
        from scope_models.plotting import plot_scene

        motion, shape, positions = self.motion, self.detector.shape, self.positions
        x, y = positions[0, 0] + motion.x, positions[0, 1] + motion.y
        label = f"Time ({motion.time_format.upper()})"
        mags = [star.mag for star in self.stars]
        return plot_scene(motion.time, x, y, shape, positions, mags, time_label=label, ax=ax)

    read, write = classmethod(_storage.read), _storage.write


def _places(scene):
    """Return the given columns and rows of the stars, by default the middle, ``(k, 2)``."""
    given = np.array([(star.x_0, star.y_0) for star in scene.stars], dtype=float)
    middle = (np.array(scene.detector.shape[::-1]) - 1) / 2
    return np.where(np.isnan(given), middle, given)


def _identity(scene):
    given = {name: getattr(scene, name) for name in _IDENTITY}
    return {name: value for name, value in given.items() if value is not None}


def _middle_year(motion):
    days = TIME_ZEROS[motion.time_format] + (motion.time[0] + motion.time[-1]) / 2
    return 2000.0 + float(days - 2451545.0) / 365.25


def scene_facts(scene):
    """Return the scene's target and stamp as fields of `TPFMetadata`."""
    x_0, y_0 = _places(scene)[0].tolist()
    facts = {"target_id": 1, "magnitude": scene.stars[0].mag, "x_0": x_0, "y_0": y_0}
    return facts | {"seed": scene.seed} | dict(scene.metadata) | _identity(scene)


def _checked_signal(signal):
    """Return a signal of an allowed kind; arrays are copied, checked and made read-only."""
    if isinstance(signal, Model):
        if (signal.n_inputs, signal.n_outputs) != (1, 1):
            raise TypeError(f"`signal` must be a model of time alone, got {signal!r}")
        return signal.copy()
    if signal is None or callable(signal):
        return signal
    try:
        values = np.array(plain_array(signal, u.one, "signal"))
    except TypeError:
        values = np.array(0.0)
    if values.ndim != 1:
        wanted = "a model, a function of time, a one-dimensional array or None"
        raise TypeError(f"`signal` must be {wanted}, got {signal!r}")
    return frozen(_check_values(values))


def _check_values(signal):
    if not np.all(np.isfinite(signal)):
        raise ValueError("`signal` must be finite in every cadence")
    if np.any(signal < 0):
        raise ValueError(f"`signal` must not be negative, got {signal.min()}")
    return signal


def _star_frame(coord, shape, wcs):
    """Return the target's place, the pixel scale (arcsec) and the matrix of a scene, of a WCS."""
    x, y = (float(value) for value in wcs.world_to_pixel(coord))
    if not np.hypot(x, y) < 10 * sum(shape):
        raise ValueError(f"`coord` is far from the field of `wcs`: column {x:g}, row {y:g}")
    steps = wcs.pixel_to_world([x + 1, x], [y, y + 1])
    east, north = (q.to_value(u.arcsec) for q in coord.spherical_offsets_to(steps))
    scale = float(np.sqrt(abs(east[0] * north[1] - east[1] * north[0])))
    return (x, y), scale, tuple((np.concatenate([-east, north]) / scale).tolist())


def _find_target(coord, target, places, mags, pixel_scale):
    """Return the target's place, the target, and places and magnitudes of the other stars."""
    if not isinstance(target, Star | None):
        raise TypeError(f"`target` must be a Star, got {target!r}")
    distance = coord.separation(places).arcsec
    nearest = np.argsort(distance, kind="stable")[:1]
    same = nearest[distance[nearest] <= pixel_scale]
    if target is None:
        if not len(same):
            far = "".join(f"; the nearest is {d / 3600:.3g} deg away" for d in distance[nearest])
            lacking = f"`table` has no star within a pixel of `coord`{far}"
            raise ValueError(f"{lacking}: give the `target`")
        coord, target = places[same[0]], Star(mags[same[0]])
    others = np.delete(np.arange(len(mags)), same)
    return coord, target.replace(coord=None), places[others], mags[others]


def _place_stars(base, places, mags, magnitude_limit, background_stars, psf):
    """Return the target and the stars whose light falls into the stamp of a scene of the target."""
    xy = np.column_stack([places.ra.deg, places.dec.deg])
    xy = base.wcs.wcs_world2pix(xy, 0) if len(xy) else xy
    used = np.isfinite(xy).all(axis=1)
    if magnitude_limit is not None:
        used &= mags <= plain_number(magnitude_limit, u.mag, "magnitude_limit")
    drawn_xy, drawn = _draw(base, background_stars, mags[used])
    xy, mags = np.concatenate([xy[used], drawn_xy]), np.append(mags[used], drawn)

    @cache
    def psf_at(x, y):
        column = TPFMetadata.column if base.column is None else base.column
        row = TPFMetadata.row if base.row is None else base.row
        at = psf.at if isinstance(psf, PRFGrid) else psf
        return None if at is None else at(column + x, row + y)

    target = base.stars[0]
    target = target if psf is None else target.replace(psf=psf_at(*base.positions[0]))
    kept = _lighting(base, xy, mags, target.psf or base.detector.psf)
    blocks = _PSF_BLOCK * (xy[kept] // _PSF_BLOCK + 0.5)
    found = zip(mags[kept], xy[kept], blocks, strict=True)
    return [target, *(Star(mag, *place, psf=psf_at(*block)) for mag, place, block in found)]


def _column(table, names, unit, needed=None):
    """Return the values of the first column of some names, or None if it is not needed."""
    known = {name.lower(): name for name in table.colnames}
    name = next((known[name] for name in names if name in known), None)
    if name is None and needed:
        found = ", ".join(table.colnames) or "none"
        raise ValueError(f"`table` must have a column {needed}, got {found}")
    return None if name is None else plain_array(table[name], unit, f"table[{name!r}]")


def _read_catalog(table, mission, magnitude, ref_epoch, year):
    """Return places at a time (Julian year), and magnitudes, of a catalog's stars."""
    if table is None:
        return SkyCoord([], [], unit=u.deg), np.zeros(0)
    try:
        table = Table(table)
    except (TypeError, ValueError) as error:
        kind = type(table).__name__
        raise TypeError(f"`table` must be a Table or a mapping of columns, got {kind}") from error
    band = MISSIONS[mission].band if mission in MISSIONS else ""
    names = _MAGNITUDES.get(band, ()) + _ANY_MAGNITUDE
    names = names if magnitude is None else (magnitude.lower(),)
    if ref_epoch is not None:
        is_time = isinstance(ref_epoch, Time)
        ref_epoch = ref_epoch.jyear if is_time else plain_number(ref_epoch, u.yr, "ref_epoch")
    ra, dec = _column(table, _RA, u.deg, "ra"), _column(table, _DEC, u.deg, "dec")
    mags = _column(table, names, u.mag, " or ".join(names))
    if np.any(np.abs(dec) > 90):
        raise ValueError("`table` must have declinations within -90 to 90")
    good = np.isfinite(ra) & np.isfinite(dec) & np.isfinite(mags)
    if not good.all():
        lacking = f"{np.sum(~good)} of {len(good)} stars of the table have no place or no magnitude"
        warnings.warn(f"{lacking}, and are left out", CatalogWarning, stacklevel=3)
    places = SkyCoord(ra[good], dec[good], unit=u.deg)
    motions = [_column(table, names, u.mas / u.yr) for names in _PROPER_MOTIONS]
    if any(m is None for m in motions) or not good.any():
        return places, mags[good]
    epoch = _column(table, _EPOCH, u.yr) if ref_epoch is None else ref_epoch
    if epoch is None or not np.all(np.isfinite(epoch)):
        raise ValueError("`ref_epoch` must be given: `table` has proper motions, but no epoch")
    since = np.broadcast_to(year - epoch, good.shape)[good]
    offsets = (np.nan_to_num(m[good]) * since * u.mas for m in motions)
    return places.spherical_offsets_by(*offsets), mags[good]


def _draw(base, faintest, mags):
    """Return places and magnitudes of stars that are fainter than a catalog's."""
    if faintest is None:
        return np.zeros((0, 2)), np.zeros(0)
    faintest = plain_number(faintest, u.mag, "background_stars")
    generator = np.random.default_rng([base.seed or 0, 1])
    grid = np.linspace(min(max(mags, default=_BRIGHTEST), faintest), faintest, 200)
    counts = star_counts(grid, SkyCoord(base.ra, base.dec, unit=u.deg))
    size = np.array(base.detector.shape[::-1]) + 2 * _MARGIN
    area = size.prod() * (base.detector.pixel_scale / 3600) ** 2
    deviates = generator.random((generator.poisson(area * (counts[-1] - counts[0])), 3))
    drawn = np.interp(counts[0] + deviates[:, 0] * (counts[-1] - counts[0]), counts, grid)
    return deviates[:, 1:] * size - _MARGIN - 0.5, drawn


def _lighting(base, xy, mags, model):
    detector, size = base.detector, np.array(base.detector.shape[::-1])
    moved, middle = np.column_stack([base.motion.x, base.motion.y]), (size - 1) / 2
    # The place within the motion that is nearest to the middle of the stamp.
    nearest = np.clip(middle, xy + moved.min(axis=0), xy + moved.max(axis=0))
    outside = np.hypot(*np.maximum(np.abs(nearest - middle) - size / 2, 0).T)
    kept = outside == 0
    seconds = detector.exposure_time
    variance = detector.background * seconds + detector.cadence_read_noise**2
    least = _LEAST_NOISE * max(np.sqrt(variance), 1.0) / seconds
    candidates = np.flatnonzero((outside > 0) & (outside < _FARTHEST))
    for part in np.split(candidates, range(_BATCH, len(candidates), _BATCH)):
        images = unit_images(model, detector.shape, *nearest[part].T)
        brightest = images.max(axis=(1, 2), initial=0.0)
        kept[part] = brightest * detector.flux_from_mag(mags[part]) > least
    return kept
