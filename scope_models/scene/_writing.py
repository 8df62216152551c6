"""The method that writes scenes, detectors and motions."""

from scope_models._docstrings import documented

__all__ = ["write"]


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
