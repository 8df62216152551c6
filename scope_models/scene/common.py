"""The common motion of the stars of a CCD: pointing, roll and scale."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from scope_models._arrays import plain_number
from scope_models._values import frozen
from scope_models.scene.motion import Motion, as_pixels

__all__ = ["CommonMotion"]


@dataclass(frozen=True, eq=False, repr=False)
class CommonMotion(Motion):
    r"""The motion that all stars of a CCD share, with errors.

    A star at :math:`(X, Y)`, pixels from ``place``, is displaced by :math:`x + s X - \theta Y` and
    :math:`y + s Y + \theta X`, with the scale s and the roll :math:`\theta` of the cadence: `at`.
    `~scope_models.Motion.from_tpfs` makes it, with errors from the scatter of the stars about it,
    without those of the PSF that all share.

    Parameters
    ----------
    time, x, y, quality, cadenceno, time_format, meta : object
        As those of `~scope_models.Motion`, at ``place``.
    x_err, y_err : array_like of shape (n,)
        Standard deviations of x and y, pixels.
    roll, scale : array_like of shape (n,)
        Roll, radians, and relative change of the scale.
    roll_err, scale_err : array_like of shape (n,)
        Their standard deviations; all errors count as independent.
    place : tuple of float
        Column and row on the CCD.

    Raises
    ------
    ValueError
        As `~scope_models.Motion`.

    Examples
    --------
    >>> from scope_models.scene.common import CommonMotion
    >>> names = ("x", "y", "x_err", "y_err", "scale", "roll_err", "scale_err")
    >>> motion = CommonMotion(time=[0.0], roll=[1e-4], **dict.fromkeys(names, [0.0]))
    >>> motion.at(200.0, 0.0).y
    array([0.02])
    """

    x_err: np.ndarray = None
    y_err: np.ndarray = None
    roll: np.ndarray = None
    scale: np.ndarray = None
    roll_err: np.ndarray = None
    scale_err: np.ndarray = None
    place: tuple = (0.0, 0.0)

    offsets_of: ClassVar[tuple] = ("x", "y", "roll", "scale")
    errors_of: ClassVar[tuple] = ("x_err", "y_err", "roll_err", "scale_err")

    def __post_init__(self):
        super().__post_init__()
        for name in (*self.offsets_of[2:], *self.errors_of):
            value = as_pixels(getattr(self, name), name, len(self.time))
            if not np.isfinite(value).all() or (name in self.errors_of and value.min() < 0):
                raise ValueError(f"`{name}` must be finite, and no error below 0")
            object.__setattr__(self, name, frozen(value))
        object.__setattr__(self, "place", tuple(map(float, self.place)))

    def at(self, column, row):
        """Return the motion of a star at a place of the CCD.

        Parameters
        ----------
        column, row : float or Quantity
            The place, pixels, as 1CRV5P and 2CRV5P count them.

        Returns
        -------
        CommonMotion
            The same motion, about this place.
        """
        column, row = plain_number(column, "pix", "column"), plain_number(row, "pix", "row")
        right, up = column - self.place[0], row - self.place[1]
        scale, roll = self.scale_err, self.roll_err
        return self.replace(
            x=self.x + self.scale * right - self.roll * up,
            y=self.y + self.scale * up + self.roll * right,
            x_err=np.sqrt(self.x_err**2 + (scale * right) ** 2 + (roll * up) ** 2),
            y_err=np.sqrt(self.y_err**2 + (scale * up) ** 2 + (roll * right) ** 2),
            place=(column, row),
        )
