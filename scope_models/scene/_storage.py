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
    >>> from scope_models import Detector, Motion, Scene, Star
    >>> scene = Scene(Star(12.0), Detector.k2(), Motion.still(10), seed=1)
    >>> Scene.read(scene.write("scene.fits")) == scene
    True
    >>> Detector.read(scene.detector.write("detector.fits")) == scene.detector
    True
    """
    from scope_models.scene._files import write_object

    return write_object(self, path, overwrite=overwrite)


def read(cls, path):
    """Read a scene, a detector or a motion, as the class says.

    Parameters
    ----------
    path : str or path-like
        A file of `write`, or a target pixel file that this package wrote. A detector may also be
        in TOML: see `~scope_models.read_detector`. A motion may also be a table in ECSV with time,
        x, y, quality and cadenceno, whose units convert, and with time_format in its header.

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
