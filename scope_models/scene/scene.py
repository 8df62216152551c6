"""Scenes: all that a simulation starts from."""

from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass, field
from functools import partial
from types import MappingProxyType

import numpy as np

from scope_models._checks import check_fields, checked_matrix, integer, number
from scope_models._docstrings import documented
from scope_models._values import Value, html_table
from scope_models.effects import Effect, mission_effects
from scope_models.effects._noise import noise_terms
from scope_models.effects.base import checked_several
from scope_models.io import TPFMetadata
from scope_models.io._headers import tan_projection
from scope_models.missions import TIME_ZEROS
from scope_models.models._description import check_coord, sky_place
from scope_models.scene import _storage
from scope_models.scene.catalog import find_target, place_stars, read_catalog, star_frame
from scope_models.scene.detector import Detector
from scope_models.scene.motion import Motion
from scope_models.scene.star import Star

__all__ = ["Scene"]

_SAME = 0.1  # deg
# Header cards on the star and on the place of the stamp.
_IDENTITY = ("target_id", "object_name", "ra", "dec", "orientation", "matrix", "column", "row")


@dataclass(frozen=True, eq=False, repr=False)
class Scene(Value):
    """All that a simulation starts from.

    ``simulate(scene)`` gives its pixels. A scene also unpacks as the arguments of the short form:
    ``simulate(*scene, **scene.options)``. It does not change; `replace` gives a new one.

    Parameters
    ----------
    stars : Star or sequence of Star
        The stars; the first is the target.
    detector : Detector
        The pixels.
    motion : Motion
        The motion that all stars share.
    seed : int, optional
        The seed of the interpixel map and of all noise. None takes one from the operating system
        when the scene is simulated.
    noise : bool or str or iterable of str, optional
        True for photon, background and read noise, False for none, or names out of "photon",
        "background", "read" and "quantization".
    n_sub : int, optional
        Exposures within a cadence over which the motion is averaged. Positions are interpolated
        between the middles of the cadences by straight lines, and stay before the first and after
        the last. The relative flux is a mean over the cadence in any case.
    effects : Effect or sequence of Effect or "mission", optional
        What sky, telescope and detector do besides noise and saturation, with the detector's
        own effects; their order does not matter: see `scope_models.effects`. "mission" are those of
        `~scope_models.effects.mission_effects`.
    target_id : int, optional
        KEPLERID or TICID of the target in a file; the default is 1.
    object_name : str, optional
        Name of the target in a file; the default is "SIM" and the number.
    ra, dec : float or Quantity, optional
        Place of the target on the sky, deg (ICRS); by default the middle of a field of the mission.
    orientation : float or Quantity, optional
        Position angle of the direction of growing rows, deg from north to east.
    matrix : tuple of float, optional
        PC1_1, PC1_2, PC2_1 and PC2_2 of the projection, in place of ``orientation``: what a step
        along columns and rows is to the west and to the north.
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
    >>> from scope_models import Detector, Motion, Scene, Star, simulate
    >>> scene = Scene(Star(12.0), Detector.k2(), Motion.still(10), seed=1)
    >>> scene
    <Scene of 1 star, K2, 10 cadences of 11 x 11 pixels, seed 1>
    >>> simulate(scene)
    <Observation K2: 10 cadences of 11 x 11 pixels, 1 star, seed 1>
    >>> stars, detector, motion = scene
    >>> scene.replace(seed=2).options["seed"]
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
        for name, kind in (("detector", Detector), ("motion", Motion)):
            if not isinstance(getattr(self, name), kind):
                raise TypeError(f"`{name}` must be a {kind.__name__}, got {getattr(self, name)!r}")
        put("noise", noise_terms(self.noise))
        check_fields(self)
        own = isinstance(self.effects, str) and self.effects == "mission"
        effects = mission_effects(self.detector) if own else self.effects
        put("effects", checked_several("effects", effects, Effect))
        self._put_on_sky()
        if not isinstance(self.object_name, str | None):
            raise TypeError(f"`object_name` must be text, got {self.object_name!r}")
        if not isinstance(self.metadata, Mapping):
            raise TypeError(f"`metadata` must be a mapping, got {self.metadata!r}")
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
        identity = {name: getattr(self, name) for name in _IDENTITY}
        options |= {name: value for name, value in identity.items() if value is not None}
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
            The catalog: columns ``ra`` and ``dec`` (deg, ICRS), a magnitude, and if wanted
            proper motions ``pmra`` (times the cosine of the declination) and ``pmdec``, mas/yr,
            and their ``ref_epoch`` (Julian year). Names of Gaia, of VizieR and of the missions'
            catalogs are found. Stars without a place or a magnitude are left out with a warning;
            missing proper motions are 0. None means no catalog.
        coord : SkyCoord
            Place of the target at the time of the motion.
        detector : Detector
            The pixels.
        motion : Motion
            The motion that all stars share. Proper motions move stars to its middle.
        target : Star, optional
            The target, with its signal; its ``x_0`` and ``y_0`` are where ``coord`` is, by default
            the middle of the stamp. It replaces the star of the table within a pixel of
            ``coord``, if there is one. By default that star is the target.
        orientation : float or Quantity, optional
            Position angle of the direction of growing rows, deg from north to east.
        wcs : astropy.wcs.WCS, optional
            World coordinates of the stamp, as of a target pixel file, in place of
            ``orientation``. They give the target's place and the pixel scale, too; distortions
            within the stamp are left out.
        magnitude : str, optional
            Column of the magnitudes; by default the mission's band, else ``mag``, else Gaia's G,
            taken as the mission's.
        magnitude_limit : float or Quantity, optional
            Fainter stars of the table are left out.
        background_stars : float or Quantity, optional
            Draw stars down to this magnitude by `~scope_models.scene.catalog.star_counts`, fainter
            than all that are used of the table, at random places. ``seed`` fixes them.
        ref_epoch : float, Quantity or Time, optional
            Epoch of the table's places, Julian year, if it has no column of it.
        psf : astropy.modeling.Model, PRFGrid or callable, optional
            PSF of all stars, or how it varies with the place: PRFs of several places, or a
            function of detector column and row that returns a model. It is taken at the middle of
            blocks of 64 by 64 pixels.
        **fields
            Other fields of `Scene`, as ``seed``, ``column`` and ``row``.

        Returns
        -------
        Scene
            The target and all stars whose light falls into the stamp: those on it, and those
            outside that add more than 1 % of the noise of a dark pixel to any pixel.

        Raises
        ------
        TypeError
            If an argument is of the wrong kind.
        ValueError
            If the table lacks a column or has no star at ``coord``, or ``wcs`` is of another field.

        Warns
        -----
        CatalogWarning
            If stars of the table are left out because a number is missing.

        Examples
        --------
        >>> from astropy.coordinates import SkyCoord
        >>> from scope_models import Detector, Motion, Scene
        >>> table = {"ra": [40.0, 40.003], "dec": [-20.0, -19.998], "mag": [12.0, 14.5]}
        >>> coord = SkyCoord(40.0, -20.0, unit="deg")
        >>> scene = Scene.from_catalog(table, coord, Detector.k2(), Motion.k2_roll(50), seed=1)
        >>> print(scene.positions.round(2))
        [[5.   5.  ]
         [2.45 6.81]]
        """
        check_coord(coord)
        year = _middle_year(motion)
        places, mags = read_catalog(table, detector.mission, magnitude, ref_epoch, year)
        coord, target, others = find_target(coord, target, places, mags, detector.pixel_scale)
        if wcs is not None:
            place, scale, fields["matrix"] = star_frame(coord, detector.shape, wcs)
            detector = detector.replace(pixel_scale=scale)
            target = target.replace(x_0=place[0], y_0=place[1])
        if psf is not None and hasattr(psf, "param_names"):
            detector, psf = detector.replace(psf=psf), None
        ra, dec = coord.icrs.ra.deg, coord.icrs.dec.deg
        base = cls(target, detector, motion, ra=ra, dec=dec, orientation=orientation, **fields)
        stars = place_stars(base, places, mags, others, magnitude_limit, background_stars, psf)
        return base.replace(stars=stars)

    @documented()
    def plot(self, ax=None):
        """Draw the stamp with the track of the target and the places of the other stars.

        Nothing is simulated.

        Parameters
        ----------
        {draw}

        Examples
        --------
        >>> from scope_models import Detector, Motion, Scene, Star
        >>> stars = [Star(12.0), Star(14.0, 8.0, 2.0)]
        >>> ax = Scene(stars, Detector.k2(shape=(11, 11)), Motion.k2_roll(50)).plot()
        >>> [text.get_text() for text in ax.texts]
        ['12', '14']
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


def _middle_year(motion):
    days = TIME_ZEROS[motion.time_format] + (motion.time[0] + motion.time[-1]) / 2
    return 2000.0 + float(days - 2451545.0) / 365.25


def scene_facts(scene):
    """Return the scene's target and stamp as fields of `TPFMetadata`."""
    x_0, y_0 = _places(scene)[0].tolist()
    facts = {"target_id": 1, "magnitude": scene.stars[0].mag, "x_0": x_0, "y_0": y_0}
    facts |= {"seed": scene.seed} | dict(scene.metadata)
    return facts | {name: value for name, value in scene.options.items() if name in _IDENTITY}
