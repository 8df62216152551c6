"""How far a star moves, in numbers."""

from dataclasses import dataclass, fields, replace

import astropy.units as u
import numpy as np

from scope_models._arrays import PER_PIXEL, plain_array, plain_number

__all__ = ["MotionStatistics", "largest_distance"]


@dataclass(frozen=True)
class MotionStatistics:
    """The row of a motion in a table of motions.

    Attributes
    ----------
    mean, std, maximum : ~astropy.units.Quantity
        Mean, standard deviation and maximum of the distance from the reference position, in
        pixels.
    extent : ~astropy.units.Quantity
        Largest distance between any two positions, in pixels.
    pixel_scale : ~astropy.units.Quantity
        Size of a pixel.
    n_cadences : int
        Number of cadences.

    Examples
    --------
    >>> from scope_models import Motion
    >>> Motion([0, 1], [0.0, 0.3], [0.0, 0.4]).statistics().to_table().colnames
    ['mean', 'std', 'maximum', 'extent', 'pixel_scale', 'n_cadences']
    """

    mean: u.Quantity
    std: u.Quantity
    maximum: u.Quantity
    extent: u.Quantity
    pixel_scale: u.Quantity
    n_cadences: int

    @classmethod
    def of_positions(cls, x, y, pixel_scale):
        """Measure positions.

        Parameters
        ----------
        x, y : array_like or Quantity, shape (n,)
            Offsets from the reference position in pixels.
        pixel_scale : float or Quantity
            Size of a pixel in arcsec.

        Returns
        -------
        MotionStatistics
            The statistics.

        Examples
        --------
        >>> import numpy as np
        >>> from scope_models.scene.motion import MotionStatistics
        >>> MotionStatistics.of_positions(np.array([0.3]), np.array([0.4]), 3.98).mean
        <Quantity 0.5 pix>
        """
        scale = plain_number(pixel_scale, u.arcsec, "pixel_scale", equivalencies=PER_PIXEL)
        x, y = (plain_array(v, u.pix, n, pixel_scale=scale) for v, n in ((x, "x"), (y, "y")))
        r = np.hypot(x, y)
        values = (r.mean(), r.std(), r.max(), largest_distance(x, y))
        pixel = scale * u.arcsec / u.pix
        return cls(*(float(value) * u.pix for value in values), pixel, len(r))

    def __str__(self):
        unit = "px" if self.mean.unit == u.pix else str(self.mean.unit)
        return (
            f"{self.mean.value:.3f} +- {self.std.value:.3f} {unit}, "
            f"max {self.maximum.value:.3f} {unit}, extent {self.extent.value:.2f} {unit}"
        )

    def in_arcsec(self):
        """Return the same statistics as angles.

        Returns
        -------
        MotionStatistics
            The statistics with mean, std, maximum and extent in arcsec.

        Examples
        --------
        >>> from scope_models import Motion
        >>> Motion([0, 1], [0.0, 0.3], [0.0, 0.4]).statistics(4.0).in_arcsec().maximum
        <Quantity 2. arcsec>
        """
        names = ("mean", "std", "maximum", "extent")
        if self.mean.unit == u.arcsec:
            return self
        return replace(
            self, **{k: (getattr(self, k) * self.pixel_scale).to(u.arcsec) for k in names}
        )

    def to_table(self):
        """Return the statistics as a table of one row, to be stacked with others.

        Returns
        -------
        astropy.table.QTable
            One column with its unit for each of the attributes.

        Examples
        --------
        >>> from scope_models import Motion
        >>> len(Motion([0, 1], [0.0, 0.3], [0.0, 0.4]).statistics().to_table())
        1
        """
        from astropy.table import QTable

        return QTable([{item.name: getattr(self, item.name) for item in fields(self)}])


def largest_distance(x, y):
    """Return the largest distance between any two points.

    The two points are corners of the convex hull, which has few.

    Parameters
    ----------
    x, y : ndarray, shape (n,)
        The points.

    Returns
    -------
    float
        The distance.
    """
    # Not imported with the package: it takes a third of the time that the package has for that.
    from scipy.spatial import ConvexHull, QhullError
    from scipy.spatial.distance import pdist

    points = np.column_stack([x, y])
    points = points - points.mean(axis=0)
    try:
        hull = points[ConvexHull(points).vertices]
    except QhullError:
        # All points lie on a line, or there are fewer than three.
        along = points @ np.linalg.svd(points, full_matrices=False)[2][0]
        return float(np.ptp(along))
    return float(pdist(hull).max())
