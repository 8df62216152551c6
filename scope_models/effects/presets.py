"""The effects of each mission whose numbers have a source."""

from scope_models.effects.charge import CosmicRays, RollingBands, Smear, Undershoot
from scope_models.effects.light import Focus
from scope_models.effects.sky import ScatteredLight

__all__ = ["mission_effects"]


def mission_effects(detector):
    """Return the effects that a mission's detector has.

    A detector of Kepler or K2 has cosmic rays (5 per square centimeter and second, pixels of 27
    micrometers: ETEM2, the simulator of the Kepler project), smear (1070 rows, KSCI-19033),
    undershoot (0.0039, decay over 5 pixels) and rolling bands (20 ppm of a star of Kp 12). K2 has
    a focus that changes by 1 % over a campaign of 80 days, as the fitted widths of real stars of
    campaign 5. A detector of TESS has cosmic rays (pixels of 15 micrometers), of which the
    highest and the lowest of ten reads are dropped where the detector's cadence does so, and
    scattered light at both ends of an orbit. What is assumed is in the description of each
    effect. Effects without a number of the mission, as dropouts of the sensitivity, are not
    among them. The width of a PRF table cannot change: leave the focus out with one.

    Parameters
    ----------
    detector : Detector
        The detector; its mission and its cadence choose the effects.

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
