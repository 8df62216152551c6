"""The methods that write and read scenes, detectors and motions."""

from scope_models._docstrings import documented

__all__ = ["read", "write"]


@documented()
def write(self, path, overwrite=False):
    """Write the object, as it is, as .fits or .fits.gz; ``read`` of its class reads it.

    Parameters
    ----------
    {write}

    Examples
    --------
    >>> from scope_models import Detector
    >>> detector = Detector.k2()
    >>> Detector.read(detector.write("detector.fits")) == detector
    True
    """
    from scope_models.scene._files import write_object

    return write_object(self, path, overwrite=overwrite)


def read(cls, path):
    """Read a scene, a detector or a motion, as the class says.

    Parameters
    ----------
    path : str or path-like
        A file of `write`, or a target pixel file of this package. A detector may also be in TOML:
        see `~scope_models.read_detector`. A motion may also be in ECSV with the columns time, x, y,
        quality and cadenceno, and with time_format in its header.

    Returns
    -------
    Scene, Detector or Motion
        The object, equal to the written one.

    Raises
    ------
    OSError
        If the file cannot be opened.
    ValueError
        If it holds no such object.

    Examples
    --------
    >>> from scope_models import Motion
    >>> Motion.read(Motion.still(3).write("still.fits")).x
    array([0., 0., 0.])
    """
    from scope_models.scene._files import read_object

    return read_object(cls, path)
