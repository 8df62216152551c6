"""PRF tables at several places of a detector: photutils' and the official ones."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from astropy import units as u
from scipy.interpolate import LinearNDInterpolator

from scope_models._arrays import plain_array, plain_number
from scope_models._values import Value, frozen
from scope_models.models.tables import TabulatedPRF, integer_oversampling

__all__ = ["PRFGrid"]

# Farther outside the places nothing is extrapolated, pixels.
_FAR = 100.0


@dataclass(frozen=True, eq=False, repr=False)
class PRFGrid(Value):
    """PRF tables at several places of a detector.

    Parameters
    ----------
    places : array_like of shape (n, 2)
        Column and row of each table.
    tables : tuple of TabulatedPRF
        The tables, all of one shape, oversampling and origin.

    Raises
    ------
    ValueError
        If the tables do not belong together, or there are two for one place.

    Examples
    --------
    >>> import numpy as np
    >>> from scope_models.models import PRFGrid, TabulatedPRF
    >>> places = [(1, 1), (1, 101), (101, 1), (101, 101)]
    >>> y, x = np.mgrid[-5:6, -5:6]
    >>> tables = [TabulatedPRF(np.exp(-(x**2 + y**2) / (2 + c / 100))) for c, r in places]
    >>> table = PRFGrid(places, tables).at(51, 20)
    >>> print(f"{table(1, 0):.4f}")
    0.6627
    """

    places: np.ndarray
    tables: tuple

    def __post_init__(self):
        places = plain_array(self.places, u.pixel, "places")
        tables = tuple(self.tables)
        if places.shape != (len(tables), 2) or not np.isfinite(places).all() or not tables:
            raise ValueError(f"`places` must have the shape ({len(tables)}, 2), got {places.shape}")
        if len(np.unique(places, axis=0)) < len(places):
            raise ValueError("`places` must differ: two tables have the same place")
        first = tables[0]
        for table in tables:
            same = table.array.shape == first.array.shape and table.origin == first.origin
            if not same or table.oversampling != first.oversampling:
                raise ValueError("`tables` must have one shape, oversampling and origin")
        object.__setattr__(self, "places", frozen(places))
        object.__setattr__(self, "tables", tables)

    def weights(self, column, row):
        """Return the weight of each table at a place.

        Bilinear where the places are a rectangular grid, else linear in the triangles between
        them. Outside the places the nearest edge counts.

        Parameters
        ----------
        column, row : float or `~astropy.units.Quantity`
            The place in pixels.

        Returns
        -------
        weights : `~numpy.ndarray`
            Not negative, of sum 1.

        Raises
        ------
        ValueError
            If the place is more than 100 px outside.
        """
        given = {"column": column, "row": row}
        place = np.array([plain_number(value, u.pixel, name) for name, value in given.items()])
        low, high = self.places.min(axis=0), self.places.max(axis=0)
        if not (np.all(place >= low - _FAR) and np.all(place <= high + _FAR)):
            raise ValueError(
                f"`column` and `row` must be near columns {low[0]:g} to {high[0]:g} and rows "
                f"{low[1]:g} to {high[1]:g}, got {place[0]:g} and {place[1]:g}"
            )
        place = np.clip(place, low, high)
        columns, rows = (np.unique(p) for p in self.places.T)
        if columns.size * rows.size == len(self.tables):
            weights = 1.0
            for nodes, at, places in zip((columns, rows), place, self.places.T, strict=True):
                along = np.array([np.interp(at, nodes, row) for row in np.eye(nodes.size)])
                weights = weights * along[np.searchsorted(nodes, places)]
            return weights
        weights = LinearNDInterpolator(self.places, np.eye(len(self.tables)))(place)[0]
        if np.isnan(weights).any():
            raise ValueError(f"column {place[0]:g}, row {place[1]:g} is not between the places")
        return np.maximum(weights, 0.0)

    def at(self, column=None, row=None):
        """Return the table of a place.

        Parameters
        ----------
        column, row : float or `~astropy.units.Quantity`, optional
            The place in pixels, as the tables count them; not needed for a single table.

        Returns
        -------
        table : TabulatedPRF
            Its uncertainty is that of the weighted tables.

        Raises
        ------
        ValueError
            If the place is more than 100 px outside, or left out of several.
        """
        first = self.tables[0]
        if column is None and row is None and len(self.tables) == 1:
            return first
        if column is None or row is None:
            raise ValueError("`column` and `row` must be given: there are tables of several places")
        weights = self.weights(column, row)
        used = [(w, t) for w, t in zip(weights, self.tables, strict=True) if w]
        error = None
        if all(table.uncertainty is not None for _, table in used):
            error = np.sqrt(sum((w * table.uncertainty) ** 2 for w, table in used))
        samples = sum(w * table.array for w, table in used)
        return TabulatedPRF(samples, first.oversampling, origin=first.origin, uncertainty=error)

    def to_photutils(self):
        """Return the grid as a model of photutils, which is bilinear between the places too.

        Returns
        -------
        model : `~photutils.psf.GriddedPSFModel`
            With x_0 and y_0 in the pixels of the places.

        Raises
        ------
        ValueError
            If the places are not a rectangular grid.
        """
        from astropy.nddata import NDData
        from photutils.psf import GriddedPSFModel

        columns, rows = (np.unique(p) for p in self.places.T)
        if columns.size * rows.size != len(self.tables):
            raise ValueError("photutils needs places on a rectangular grid; use at(column, row)")
        meta = {
            "grid_xypos": [tuple(place) for place in self.places.tolist()],
            "oversampling": integer_oversampling(self.tables[0].oversampling),
        }
        return GriddedPSFModel(NDData(np.array([t.array for t in self.tables]), meta=meta))

    @classmethod
    def from_photutils(cls, model):
        """Make a grid of a model of photutils.

        Parameters
        ----------
        model : `~photutils.psf.GriddedPSFModel`
            The model.

        Returns
        -------
        grid : PRFGrid
            The grid.

        Raises
        ------
        TypeError
            If the model is another one.
        """
        from photutils.psf import GriddedPSFModel

        if not isinstance(model, GriddedPSFModel):
            raise TypeError(f"`model` must be a GriddedPSFModel, got {type(model).__name__}")
        tables = [TabulatedPRF(image, model.oversampling) for image in model.data]
        return cls(model.grid_xypos, tables)

    @classmethod
    def from_tess(cls, path, camera=None, ccd=None):
        """Read the official PRF tables of TESS.

        Parameters
        ----------
        path : str or path-like
            One file, or a folder with the files of at least one CCD and of one epoch (sectors 1
            to 3, or 4 and later).
        camera, ccd : int, optional
            Which CCD; not needed if there is only one.

        Returns
        -------
        grid : PRFGrid
            The tables of the CCD.

        Raises
        ------
        FileNotFoundError
            If there are no such files.
        ValueError
            If the files are not of that format, of several CCDs, or of several epochs.
        """
        path = Path(path)
        files = sorted([*path.glob("*prf*.fits"), *path.glob("*prf*.fits.gz")])
        files = files if path.is_dir() else [path]
        found = [_read_tess(file) for file in files]
        chosen = [row for row in found if camera in (None, row[0][0]) and ccd in (None, row[0][1])]
        if not chosen:
            raise FileNotFoundError(f"{path} has no PRF of camera {camera}, CCD {ccd}")
        if len({item[0] for item in chosen}) > 1:
            raise ValueError(f"{path} holds several CCDs: give `camera` and `ccd`")
        if len({item[1] for item in chosen}) < len(chosen):
            raise ValueError(f"{path} holds several epochs of a place: give the folder of one")
        return cls([item[1] for item in chosen], [item[2] for item in chosen])

    @classmethod
    def from_kepler(cls, path):
        """Read an official PRF file of Kepler, of one channel.

        Parameters
        ----------
        path : str or path-like
            The file, with five places: the corners and the center.

        Returns
        -------
        grid : PRFGrid
            The tables of the channel.

        Raises
        ------
        OSError
            If the file cannot be opened.
        ValueError
            If it is not of that format.
        """
        from astropy.io import fits

        places, tables = [], []
        with fits.open(path) as hdus:
            for hdu in hdus:
                if hdu.is_image and hdu.header.get("NAXIS") == 2:
                    step = _card(hdu.header, "CDELT1P", path), _card(hdu.header, "CDELT2P", path)
                    oversampling = tuple(round(1 / s, 6) for s in step[::-1])
                    tables.append(TabulatedPRF(hdu.data, oversampling))
                    places.append([_card(hdu.header, f"CRVAL{i}P", path) for i in (1, 2)])
        if not tables:
            raise ValueError(f"{path} holds no PRF images")
        return cls(places, tables)


def _card(header, name, path):
    try:
        return float(header[name])
    except (KeyError, TypeError, ValueError):
        raise ValueError(f"{path} is not a PRF file: it has no card {name}") from None


def _read_tess(path):
    """CCD, place and table of a file."""
    from astropy.io import fits

    with fits.open(path) as hdus:
        header = hdus[0].header
        ccd = int(_card(header, "CAM", path)), int(_card(header, "CCD", path))
        place = _card(header, "CCD_CREF", path), _card(header, "CCD_RREF", path)
        origin = tuple(_card(header, f"CRPIX{i}P", path) - 1 for i in (1, 2))
        error = np.asarray(hdus[1].data, dtype=float) if len(hdus) > 1 else None
        samples = np.asarray(hdus[0].data, dtype=float)
        oversampling = _card(header, "NSAMP", path)
        return ccd, place, TabulatedPRF(samples, oversampling, origin=origin, uncertainty=error)
