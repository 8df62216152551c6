"""The extensions of a target pixel file that hold the truth."""

import json
import re
from dataclasses import dataclass

import numpy as np
from astropy.table import Table

__all__ = ["TPFTruth", "map_hdus", "scene_hdu", "truth_hdu", "truth_of"]

_TPF_NAMES = {
    *("PRIMARY", "TARGETTABLES", "PIXELS", "APERTURE", "TARGET COSMIC RAY"),
    *("TRUTH", "SCENE"),
}


@dataclass(frozen=True, eq=False)
class TPFTruth:
    """What a simulated target pixel file knows beyond its pixels.

    Attributes
    ----------
    table : astropy.table.Table
        CADENCENO and the true values at each cadence, float64.
    maps : dict of str to ndarray
        Images such as the response of each pixel, float64.
    scene : dict
        What is needed to simulate the same again.

    Examples
    --------
    >>> from astropy.table import Table
    >>> from scope_models.io import TPFTruth
    >>> truth = TPFTruth(Table({"CADENCENO": [3, 4, 5], "X": [0.0, 0.5, 1.0]}), {}, {})
    >>> truth.at_cadences([5, 3])["X"].tolist()
    [1.0, 0.0]
    """

    table: Table
    maps: dict
    scene: dict

    def at_cadences(self, cadenceno):
        """Return the rows of some cadences, such as those that a quality mask leaves.

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
        """
        wanted = np.asarray(cadenceno)
        known = np.asarray(self.table["CADENCENO"])
        index = np.minimum(np.searchsorted(known, wanted), len(known) - 1)
        if np.any(known[index] != wanted):
            missing = wanted[known[index] != wanted][0]
            raise ValueError(f"`cadenceno` must be cadences of the truth, got {missing}")
        return self.table[index]


def truth_hdu(cadenceno, columns):
    """Return the TRUTH table."""
    from astropy.io import fits

    arrays = {"CADENCENO": cadenceno}
    for name, values in columns.items():
        _check_name("truth_columns", name, {key.upper() for key in arrays})
        array = np.asarray(values, dtype=float)
        if array.shape[:1] != cadenceno.shape or 0 in array.shape:
            raise ValueError(
                f"`truth_columns` {name} must have a row for each of the {len(cadenceno)} "
                f"cadences, got the shape {array.shape}"
            )
        arrays[name] = array
    fields = [
        (name, ">i4" if name == "CADENCENO" else ">f8", array.shape[1:])
        for name, array in arrays.items()
    ]
    rows = np.empty(len(cadenceno), dtype=fields)
    for name, array in arrays.items():
        rows[name] = array
    hdu = fits.BinTableHDU(rows, name="TRUTH")
    hdu.header.comments["TTYPE1"] = "column title: number of the cadence"
    return hdu


def map_hdus(maps):
    """Return an image for each map."""
    from astropy.io import fits

    hdus = []
    for name, values in maps.items():
        _check_name("truth_maps", name, _TPF_NAMES | {hdu.name for hdu in hdus})
        array = np.array(values, dtype=float)
        if array.ndim != 2 or 0 in array.shape:
            raise ValueError(f"`truth_maps` {name} must be an image, got the shape {array.shape}")
        header = fits.Header([("MAPNAME", name, "name of the map of truth")])
        hdus.append(fits.ImageHDU(array, header, name=name.upper()))
    return hdus


def _check_name(argument, name, taken):
    """Check a name that becomes a column or an extension."""
    if not isinstance(name, str) or not re.fullmatch(r"[A-Za-z0-9_.\-]{1,60}", name):
        raise ValueError(
            f"`{argument}` must have names of up to 60 letters, digits and _ . -, got {name!r}"
        )
    if name.upper() in taken:
        raise ValueError(f"`{argument}` must not use the name {name}, which is taken")


def scene_hdu(scene):
    """Return the SCENE table: a row for each key."""
    from astropy.io import fits

    if not isinstance(scene, dict) or not all(
        isinstance(key, str) and key.isascii() and key == key.strip() != "" for key in scene
    ):
        raise TypeError(f"`scene` must be a dict with keys of ASCII text, got {scene!r}")
    try:
        texts = [json.dumps(value) for value in scene.values()]
    except (TypeError, ValueError) as error:
        raise TypeError(f"`scene` must hold what JSON can: {error}") from error
    widths = (max(map(len, column), default=1) for column in (list(scene), texts))
    names = {"KEY": list(scene), "VALUE": texts}
    columns = [
        fits.Column(name, f"{width}A", array=np.array(array, dtype=f"S{width}"))
        for width, (name, array) in zip(widths, names.items(), strict=True)
    ]
    hdu = fits.BinTableHDU.from_columns(columns, name="SCENE")
    hdu.header.comments["TTYPE2"] = "column title: value in JSON"
    return hdu


def truth_of(hdus):
    """Return the truth in an HDU list, or None."""
    if "TRUTH" not in hdus or hdus["TRUTH"].columns.names[:1] != ["CADENCENO"]:
        return None
    rows = hdus["TRUTH"].data
    table = Table({name: _native(rows[name]) for name in rows.names})
    maps = {hdu.header["MAPNAME"]: _native(hdu.data) for hdu in hdus if "MAPNAME" in hdu.header}
    scene = {}
    if "SCENE" in hdus:
        entries = hdus["SCENE"].data
        scene = {str(row["KEY"]): json.loads(row["VALUE"]) for row in entries}
    return TPFTruth(table, maps, scene)


def _native(array):
    """Return a copy in native byte order."""
    return np.array(array, dtype=array.dtype.newbyteorder("="))
