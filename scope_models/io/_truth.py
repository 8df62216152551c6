"""The truth behind the pixels of a simulation, in memory and in a file."""

import json
import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import count, takewhile
from types import MappingProxyType

import numpy as np
from astropy.io import fits
from astropy.table import Table

from scope_models._arrays import native
from scope_models._values import Value, frozen
from scope_models.io._headers import Block, column_cards
from scope_models.io._opening import MOST

__all__ = ["Truth", "maps_of", "scene_blocks", "scene_of", "truth_blocks", "truth_of"]

_TAKEN = {"PRIMARY", "TARGETTABLES", "PIXELS", "APERTURE", "TARGET COSMIC RAY", "TRUTH", "SCENE"}
_NUMBERED = "NUMBERED"
_LONGEST_TEXT = 2000  # CFITSIO reads texts of up to 2879 characters


@dataclass(frozen=True, eq=False, repr=False)
class Truth(Value):
    """The truth behind the pixels of an observation.

    ``observation.truth`` holds it, and `~scope_models.read_truth` reads the same from the file.

    Parameters
    ----------
    columns : mapping of str to array_like of shape (n_cadences, ...)
        CADENCENO and the true values at each cadence: TIME; QUALITY; the motion, MOTION_X and
        MOTION_Y; for each star from 1 its position X1 and Y1 (mean over the cadence, pixels) and
        relative flux SIGNAL1; TARGET_SHARE, the target's share in the light of the aperture; and
        what the effects add.
    maps : dict of str to ndarray of shape (ny, nx)
        Images: INTERPIXEL, the response of each pixel, and what the effects add.
    scene : dict
        Values in JSON, of which `~scope_models.read_scene` makes a `~scope_models.Scene`; and, as
        ``scene["found"]``, flux and lost_fraction of each star.
    tables : dict of str to astropy.table.Table
        Lists, such as the events of an effect.
    model : ndarray of shape (n_cadences, ny, nx) or None
        Expected flux without noise and background, e-/s, of ``simulate(..., keep_model=True)``. No
        file holds it: `~scope_models.Observation.model` computes it.

    Examples
    --------
    >>> from scope_models import Detector, Motion, Star, read_truth, simulate
    >>> observation = simulate(Star(12.0, x_0=4.5), Detector.k2(), Motion.still(50), seed=1)
    >>> observation.truth
    <Truth of 1 star, seed 1, noise: background, photon, read>
    >>> float(observation.truth.x[0, 0])
    4.5
    >>> read_truth(observation.write("star.fits")) == observation.truth
    True
    """

    columns: Mapping
    maps: dict = field(default_factory=dict)
    scene: dict = field(default_factory=dict)
    tables: dict = field(default_factory=dict)
    model: np.ndarray | None = field(default=None, compare=False)

    def __post_init__(self):
        columns = {name: frozen(values) for name, values in self.columns.items()}
        object.__setattr__(self, "columns", MappingProxyType(columns))

    def __repr__(self):
        n, options = len(self._names("X")), self.scene.get("options", {})
        noise = ", ".join(sorted(options.get("noise") or ())) or "none"
        stars = "1 star" if n == 1 else f"{n} stars"
        return f"<Truth of {stars}, seed {options.get('seed')}, noise: {noise}>"

    @property
    def table(self):
        """The columns as a new `~astropy.table.Table`."""
        return Table(dict(self.columns))

    @property
    def x(self):
        """Column of each star, the mean over the cadence, pixels; shape (n_stars, n_cadences)."""
        return self._stack("X")

    @property
    def y(self):
        """Row of each star, the mean over the cadence, pixels; shape (n_stars, n_cadences)."""
        return self._stack("Y")

    @property
    def relative_flux(self):
        """Flux of each star, 1 at its magnitude; shape (n_stars, n_cadences)."""
        return self._stack("SIGNAL")

    @property
    def target_share(self):
        """Target's share in the light of the aperture, NaN without light; (n_cadences,)."""
        return self.columns["TARGET_SHARE"]

    @property
    def flux(self):
        """Flux of each star at its magnitude, e-/s, before the response of the pixels."""
        return self._found("flux")

    @property
    def lost_fraction(self):
        """Part of each star's light off the stamp where the motion takes it farthest."""
        return self._found("lost_fraction")

    @property
    def interpixel(self):
        """Response of each pixel, shape (ny, nx)."""
        return frozen(self.maps["INTERPIXEL"])

    @property
    def seed(self):
        """The seed, given or the operating system's."""
        return self.scene["options"]["seed"]

    @property
    def noise(self):
        """The noise terms, a frozenset of their names."""
        return frozenset(self.scene["options"]["noise"])

    @property
    def n_sub(self):
        """Exposures within a cadence over which the motion is averaged."""
        return self.scene["options"]["n_sub"]

    def at_cadences(self, cadenceno):
        """Return the rows of some cadences.

        Parameters
        ----------
        cadenceno : array_like of int
            Numbers of the cadences, as lightkurve's ``tpf.cadenceno``.

        Returns
        -------
        astropy.table.Table
            A row for each number, in the same order.

        Raises
        ------
        ValueError
            If the truth has no such cadence.

        Examples
        --------
        >>> from scope_models.io import Truth
        >>> truth = Truth({"CADENCENO": [3, 4, 5], "X": [0.0, 0.5, 1.0]})
        >>> truth.at_cadences([5, 3])["X"].tolist()
        [1.0, 0.0]
        """
        wanted = np.asarray(cadenceno)
        known = self.columns["CADENCENO"]
        missing = wanted[~np.isin(wanted, known)]
        if missing.size:
            raise ValueError(f"`cadenceno` must be cadences of the truth, got {missing[0]}")
        return self.table[np.searchsorted(known, wanted)]

    def _names(self, prefix):
        return list(takewhile(self.columns.__contains__, (f"{prefix}{n}" for n in count(1))))

    def _stack(self, prefix):
        names = self._names(prefix)
        if not names:
            raise ValueError(f"the truth has no column {prefix}1")
        return frozen(np.stack([self.columns[name] for name in names]))

    def _found(self, name):
        if "found" not in self.scene:
            raise ValueError(f"the truth has no {name}: nothing was simulated")
        return frozen(self.scene["found"][name])


def truth_blocks(cadenceno, columns, maps, scene, tables):
    """Return the extensions that hold a truth, as of `make_tpf_hdulist`."""
    maps, hdus = maps or {}, []
    taken = _TAKEN | {name.upper() for name in maps}
    for name, table in (tables or {}).items():
        _check_name("truth_tables", name, taken | {hdu.name for hdu in hdus})
        hdu = fits.table_to_hdu(Table(table, meta={}))
        hdu.name = name.upper()
        hdu.header["TABNAME"] = (name, "name of the list of truth")
        hdus.append(hdu)
    return [_truth_block(cadenceno, columns or {}), *scene_blocks(maps, scene, hdus)]


def scene_blocks(maps, scene, further=()):
    """Return the extensions of images, further ones, and that of values in JSON."""
    blocks = {}
    for name, values in maps.items():
        _check_name("truth_maps", name, _TAKEN | blocks.keys())
        array = np.array(values, dtype=float)
        if array.ndim != 2 or 0 in array.shape:
            raise ValueError(f"`truth_maps` {name} must be an image, got the shape {array.shape}")
        cards = [("MAPNAME", name, "name of the map of truth")]
        cards.append(("EXTNAME", name.upper(), "extension name"))
        blocks[name.upper()] = Block(cards, array)
    return [*blocks.values(), *further, *([] if scene is None else [_scene_block(scene)])]


def _truth_block(cadenceno, columns):
    arrays, taken = {"CADENCENO": cadenceno}, {"CADENCENO"}
    for name, values in columns.items():
        _check_name("truth_columns", name, taken)
        taken.add(name.upper())
        array = np.asarray(values)
        array = array.astype(np.int32 if np.can_cast(array.dtype, np.int32) else float)
        if array.shape[:1] != cadenceno.shape or 0 in array.shape:
            wanted = f"a row for each of the {len(cadenceno)} cadences, got the shape {array.shape}"
            raise ValueError(f"`truth_columns` {name} must have {wanted}")
        arrays[name] = array
    arrays, numbered = _vectors(arrays)
    fields = [(name, f">{a.dtype.str[1:]}", a.shape[1:]) for name, a in arrays.items()]
    rows = np.empty(len(cadenceno), dtype=fields)
    for name, array in arrays.items():
        rows[name] = array
    cards = column_cards(rows, {"CADENCENO": "number of the cadence"})
    cards.append(("EXTNAME", "TRUTH", "extension name"))
    if numbered:
        cards.append((_NUMBERED, " ".join(numbered), "columns of vectors: a value for each star"))
    return Block(cards, rows)


def _vectors(arrays):
    """Return at most 999 arrays, X1, X2, ... as vectors X, and the names of these."""
    if len(arrays) <= MOST:
        return arrays, []
    left, joined = dict(arrays), {}
    for stem, n in Counter(name.rstrip("0123456789") for name in arrays).items():
        parts = [f"{stem}{i}" for i in range(1, n + 1)]
        if n > 1 and stem not in arrays and all(name in arrays for name in parts):
            joined[stem] = np.stack([left.pop(name) for name in parts], axis=1)
    return {**left, **joined}, list(joined)


def _check_name(argument, name, taken):
    if not isinstance(name, str) or not re.fullmatch(r"[A-Za-z0-9_.\-]{1,60}", name):
        wanted = "names of up to 60 letters, digits and _ . -"
        raise ValueError(f"`{argument}` must have {wanted}, got {name!r}")
    if name.upper() in taken:
        raise ValueError(f"`{argument}` must not use the name {name}, which is taken")


def _scene_block(scene):
    """Return the SCENE table: a row for each key, more for a long value."""
    if not isinstance(scene, dict) or not all(
        isinstance(key, str) and key.isascii() and key == key.strip() != "" for key in scene
    ):
        raise TypeError(f"`scene` must be a dict with keys of ASCII text, got {scene!r}")
    try:
        rows = [(key, part) for key, value in scene.items() for part in _parts(json.dumps(value))]
    except (TypeError, ValueError) as error:
        raise TypeError(f"`scene` must hold what JSON can: {error}") from error
    columns = [np.array(texts, dtype="S") for texts in zip(*rows, strict=True)]
    table = np.rec.fromarrays(columns or np.empty((2, 0), "S1"), names="KEY,VALUE")
    cards = column_cards(table, {"VALUE": "value in JSON"})
    return Block([*cards, ("EXTNAME", "SCENE", "extension name")], table)


def _parts(text):
    """Return parts of JSON that CFITSIO reads, without blanks at an end, which FITS drops."""
    if len(text) <= _LONGEST_TEXT:
        return [text]
    text = json.dumps(json.loads(text), separators=(",", ":")).replace(" ", "\\u0020")
    return [text[i : i + _LONGEST_TEXT] for i in range(0, len(text), _LONGEST_TEXT)]


def truth_of(hdus):
    """Return the truth in a file; None if it has no TRUTH table."""
    if "TRUTH" not in hdus or hdus["TRUTH"].columns.names[:1] != ["CADENCENO"]:
        return None
    columns = _columns_of(hdus["TRUTH"])
    for name in str(hdus["TRUTH"].header.get(_NUMBERED, "")).split():  # vectors
        columns |= {f"{name}{i}": values for i, values in enumerate(columns.pop(name).T, start=1)}
    lists = [hdu for hdu in hdus if "TABNAME" in hdu.header]
    tables = {hdu.header["TABNAME"]: Table(_columns_of(hdu)) for hdu in lists}
    return Truth(columns, maps_of(hdus), scene_of(hdus), tables)


def _columns_of(hdu):
    return {name: native(hdu.data[name]) for name in hdu.columns.names}


def maps_of(hdus):
    return {hdu.header["MAPNAME"]: native(hdu.data) for hdu in hdus if "MAPNAME" in hdu.header}


def scene_of(hdus):
    """Return the content of the SCENE table, empty without one."""
    texts = {}
    for row in hdus["SCENE"].data if "SCENE" in hdus else ():
        key = str(row["KEY"])
        texts[key] = texts.get(key, "") + str(row["VALUE"])
    return {key: json.loads(text) for key, text in texts.items()}
