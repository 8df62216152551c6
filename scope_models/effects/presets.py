"""The effects of each mission whose numbers have a source."""

from scope_models.effects.charge import CosmicRays, RollingBands, Smear, Undershoot
from scope_models.effects.light import Focus
from scope_models.effects.sky import ScatteredLight

__all__ = ["mission_effects"]


def mission_effects(detector):
    """Return the effects that a mission's detector has.

    Those of Kepler and K2 are `CosmicRays`, `Smear`, `Undershoot` and `RollingBands`, whose
    defaults are Kepler's. K2 has a `Focus`, too, that changes by 1 % over a campaign of 80 days, as
    the fitted widths of real stars of campaign 5; leave it out with a PRF table, whose width cannot
    change. TESS has `CosmicRays` in pixels of 15 micrometers, with the rejection of reads where the
    detector's cadence has it, and `ScatteredLight`. Effects without a number of the mission, as
    dropouts of the sensitivity, are not among them.

    Parameters
    ----------
    detector : Detector
        The detector.

    Returns
    -------
    tuple of Effect
        The effects, empty if the detector is of no mission. ``Scene(..., effects="mission")``
        takes them, too.

    Examples
    --------
    >>> from scope_models import Detector
    >>> from scope_models.effects import mission_effects
    >>> [effect.name for effect in mission_effects(Detector.tess())]
    ['CosmicRays', 'ScatteredLight']
    >>> mission_effects(Detector.tess(cadence="20 s"))[0].rejection
    False
    """
    if detector.mission == "TESS":
        return CosmicRays(pixel_size=15.0, rejection=detector.live_fraction < 1), ScatteredLight()
    photometer = CosmicRays(), Smear(), Undershoot(), RollingBands()
    if detector.mission == "K2":
        return Focus(0.005, period=160.0, phase=0.0), *photometer
    return photometer if detector.mission == "Kepler" else ()
