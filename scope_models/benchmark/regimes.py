"""Kinds of messy stars, and the table of all of them."""

from dataclasses import dataclass, fields

import numpy as np

from scope_models._arrays import plain_number
from scope_models._values import Value
from scope_models.scene.motion import K2Roll

__all__ = ["REGIMES", "SkyRegime"]


@dataclass(frozen=True)
class SkyRegime(Value):
    """A kind of messy star.

    Parameters
    ----------
    name : str
        Name of the regime.
    mission : {"K2", "Kepler", "TESS"}, optional
        Photometer and file layout.
    motion : {"k2", "kepler", "tess", "walk", "wheels", "rest", "jitter"}, optional
        Kind of motion.
    scale, magnitude : float, optional
        Factor of the motion; and Kp, or T for TESS.
    star : str, optional
        Kind of variability: "constant", "spots", "sine", "rr_lyrae", "delta_scuti", "eclipsing",
        "flaring", "bump", "rise" or "walk".
    period : float, optional
        Its period, the mean time between flares, the full width of a bump at half of its height,
        the time of a rise, or the correlation time of a random walk, days.
    amplitude : float, optional
        About half its relative range; of eclipses the depth, of a bump or rise the height, of a
        random walk the standard deviation.
    depth, transit_period, duration : float, optional
        Relative depth, period and duration of transits, days. A period of infinity stands for one
        transit.
    neighbors : tuple of (float, float, float), optional
        Magnitude difference, distance (px) and amplitude of a 1.1-d variability of each neighbor.
    focus, focus_period : float, optional
        Largest relative change of the PSF's width, and its period, days.
    seeing : float, optional
        Standard deviation of fast relative changes of the width, correlated over 1 h: jitter
        within an exposure, or the atmosphere.
    background : float, optional
        Background that the file's own subtraction leaves, e-/s per pixel.
    shape : tuple of int, optional
        Rows and columns.
    cosmic_rays : float, optional
        Share of all values that hold a cosmic ray in a long cadence. Two K2 files of faint stars
        look as simulated ones with 0.025.
    cadence : float, optional
        Time from cadence to cadence, days.
    longest, lost : int, optional
        Most cadences of a star, and those without a flag in which the star is off the stamp.
    positions : {"wrong", "none"}, optional
        POS_CORR of the file, as in `make_sky`.
    apart : bool, optional
        Whether no method can find the truth in the pixels of this star alone, so that only the
        quoted errors can be right: slow variability under slow motion. Scored apart.

    Examples
    --------
    >>> from scope_models.benchmark import SkyRegime, make_sky
    >>> regime = SkyRegime("faint", magnitude=16.5, neighbors=((1.0, 3.0, 0.0),))
    >>> make_sky(regime, seed=1, n_cadences=100).flux.shape
    (100, 9, 9)
    """

    name: str
    mission: str = "K2"
    motion: str = "k2"
    scale: float = 1.0
    magnitude: float = 12.0
    star: str = "constant"
    period: float = 5.0
    amplitude: float = 0.0
    depth: float = 0.0
    transit_period: float = 3.1
    duration: float = 0.2
    neighbors: tuple = ()
    focus: float = 0.005
    focus_period: float = 10.0
    seeing: float = 0.0
    background: float = 3.0
    shape: tuple = (9, 9)
    cosmic_rays: float = 0.004
    cadence: float = K2Roll.cadence
    longest: int = 100_000
    lost: int = 0
    positions: str = "wrong"
    apart: bool = False

    def __post_init__(self):
        days = ("period", "transit_period", "duration", "focus_period", "cadence")
        units = dict.fromkeys(days, "day") | {"magnitude": "mag", "background": "electron / s"}
        for item in fields(self):
            if isinstance(item.default, float):
                value = plain_number(getattr(self, item.name), units.get(item.name, ""), item.name)
                object.__setattr__(self, item.name, value)


def _kepler(name, **changes):
    return SkyRegime(name, mission="Kepler", motion="kepler", focus=0.003, **changes)


def _tess(name, **changes):
    settings = {"motion": "tess", "magnitude": 9.0, "focus": 0.001, "background": 5.0}
    return SkyRegime(name, mission="TESS", **{**settings, **changes})


_SPOTS = {"star": "spots", "amplitude": 0.006}
_RR_LYRAE = {"star": "rr_lyrae", "period": 0.55, "amplitude": 0.15}
_ECLIPSES = {"star": "eclipsing", "period": 2.3, "amplitude": 0.25}
_SCUTI = {"star": "delta_scuti", "period": 0.1, "amplitude": 0.01}
_BUMP = {"star": "bump", "period": 5.0, "magnitude": 13}
_FAR = {"scale": 5, "shape": (11, 11)}
_PAIR = {"star": "eclipsing", "period": 2.3, "neighbors": ((1.5, 2.5, 0),)}
_JITTER = {"motion": "jitter", "positions": "none"}
# Two minutes, of frames as those of a long cadence.
_FAST = {"cadence": K2Roll.cadence / 15, "longest": 6000, "seeing": 0.002}
_HUGE = {"scale": 10, "shape": (13, 13)}
_SINGLE = {"transit_period": np.inf}
_SHORT = {"longest": 400}

_ALL = (
    SkyRegime("k2-1x-constant"),
    SkyRegime("k2-3x-constant", scale=3),
    SkyRegime("k2-5x-constant", **_FAR),
    SkyRegime("k2-10x-constant", **_HUGE),
    SkyRegime("k2-1x-kp14", magnitude=14),
    SkyRegime("k2-1x-kp17", magnitude=17),
    SkyRegime("k2-5x-kp15", magnitude=15, **_FAR),
    SkyRegime("k2-1x-kp10-saturated", magnitude=10, shape=(13, 9)),
    SkyRegime("k2-1x-kp9-saturated", magnitude=9, shape=(29, 9)),
    SkyRegime("k2-1x-spots-5d", period=5, **_SPOTS),
    SkyRegime("k2-1x-spots-20d", period=20, **_SPOTS),
    SkyRegime("k2-5x-spots-1.5d", period=1.5, **_FAR, **_SPOTS),
    SkyRegime("k2-10x-spots-5d", period=5, **_HUGE, **_SPOTS),
    SkyRegime("k2-1x-rr-lyrae", **_RR_LYRAE),
    SkyRegime("k2-1x-rr-lyrae-neighbor", neighbors=((1, 3, 0),), **_RR_LYRAE),
    SkyRegime("k2-3x-rr-lyrae-kp15", scale=3, magnitude=15, **_RR_LYRAE),
    SkyRegime("k2-1x-delta-scuti", **_SCUTI),
    SkyRegime("k2-5x-delta-scuti", **_FAR, **_SCUTI),
    SkyRegime("k2-1x-eclipsing", **_ECLIPSES),
    SkyRegime("k2-1x-eclipsing-neighbor", neighbors=((2, 3, 0),), **_ECLIPSES),
    SkyRegime("k2-1x-flares", star="flaring", period=2.0, amplitude=0.01, magnitude=14),
    SkyRegime("k2-1x-rotation-0.5d", star="spots", period=0.5, amplitude=0.01),
    SkyRegime("k2-1x-transits-6h", depth=0.001, transit_period=0.4904, duration=0.12),
    SkyRegime("k2-5x-transit-single", depth=0.003, **_SINGLE, **_FAR),
    SkyRegime("k2-1x-transits-1pct", depth=0.01, magnitude=14),
    SkyRegime("k2-1x-transits-neighbor", depth=0.01, neighbors=((1, 3, 0),)),
    SkyRegime("k2-5x-neighbor", neighbors=((2, 3.5, 0),), **_FAR),
    SkyRegime("k2-1x-neighbor-variable", neighbors=((2, 3.5, 0.02),)),
    SkyRegime("k2-1x-neighbors-faint", neighbors=((3, 2.5, 0), (5, 4, 0), (4, 3, 0))),
    SkyRegime(
        "k2-1x-background", magnitude=17.4, star="sine", period=1.7, amplitude=0.1, background=30
    ),
    SkyRegime("k2-1x-kp18", magnitude=18, star="sine", period=2.9, amplitude=0.2),
    _kepler("kepler-constant-kp14", magnitude=14),
    _kepler("kepler-spots-10d", period=10, apart=True, **_SPOTS),
    _kepler("kepler-transits-50ppm", magnitude=10.9, depth=5e-5, transit_period=2.3),
    _kepler("kepler-transits-1pct", magnitude=14, depth=0.01),
    _tess("tess-constant"),
    _tess("tess-spots-1.5d", period=1.5, **_SPOTS),
    _tess("tess-crowded", magnitude=11, depth=0.01, neighbors=((0.5, 3.3, 0), (2, 4, 0))),
    SkyRegime("walk-constant", motion="walk"),
    SkyRegime("walk-spots-10d", motion="walk", period=10, apart=True, **_SPOTS),
    SkyRegime("wheels-constant-kp13", motion="wheels", magnitude=13, shape=(11, 11)),
    SkyRegime("wheels-spots-20d", motion="wheels", period=20, shape=(11, 11), apart=True, **_SPOTS),
    _tess("rest-eclipses-2pct-neighbor", motion="rest", amplitude=0.02, **_PAIR),
    _tess("rest-eclipses-30pct-neighbor", motion="rest", amplitude=0.3, **_PAIR),
    _tess("jitter-eclipses-10pct-neighbor", amplitude=0.1, **_JITTER, **_PAIR),
    _tess("jitter-eclipses-30pct-neighbor", amplitude=0.3, **_JITTER, **_PAIR),
    _tess("jitter-spots-3d", period=3, **_JITTER, **_SPOTS),
    _tess("rest-focus", motion="rest", focus=0.003),
    _kepler("kepler-constant-kp12"),
    SkyRegime("k2-1x-focus", focus=0.015),
    SkyRegime("k2-3x-focus-spots-5d", focus=0.015, scale=3, **_SPOTS),
    _tess("tess-focus", focus=0.01),
    SkyRegime("k2-1x-lost", lost=3),
    SkyRegime("k2-10x-lost", lost=2, **_HUGE),
    SkyRegime("k2-1x-kp9.5-saturated-lost", magnitude=9.5, shape=(21, 9), lost=2),
    SkyRegime("k2-1x-neighbor-close", neighbors=((0.5, 2.2, 0),)),
    SkyRegime("k2-1x-spots-5d-neighbor-close", neighbors=((1, 2.8, 0),), period=5, **_SPOTS),
    _tess("tess-spots-3d-neighbor-close", neighbors=((1, 2, 0),), period=3, **_SPOTS),
    SkyRegime("k2-1x-transits-12h", magnitude=13, depth=0.01, transit_period=4.1, duration=0.5),
    SkyRegime("k2-1x-transit-12h-single", magnitude=13, depth=0.01, duration=0.5, **_SINGLE),
    SkyRegime("k2-1x-transits-10pct", magnitude=14, depth=0.1, duration=0.13),
    SkyRegime("k2-10x-transits", depth=0.002, duration=0.25, **_HUGE),
    SkyRegime("k2-5x-kp9.5-saturated-spots", magnitude=9.5, scale=5, shape=(25, 13), **_SPOTS),
    SkyRegime("k2-1x-bump-1pct", amplitude=0.01, **_BUMP),
    SkyRegime("k2-1x-bump-5pct", amplitude=0.05, **_BUMP),
    SkyRegime("k2-1x-bump-50pct", amplitude=0.5, **_BUMP),
    SkyRegime("k2-1x-rise-30d", star="rise", period=30, amplitude=0.1, magnitude=13),
    SkyRegime("k2-1x-walk-20d", star="walk", period=20, amplitude=0.03, magnitude=13),
    SkyRegime("k2-1x-short-kp16", magnitude=16, **_SHORT),
    SkyRegime("k2-1x-short-delta-scuti", **_SCUTI, **_SHORT),
    _tess("tess-short", **_SHORT),
    _tess("tess-120s", magnitude=8, **_FAST),
    _tess("tess-120s-spots", positions="none", period=1.5, **_FAST, **_SPOTS),
    _tess("ground-seeing", magnitude=10, scale=5, seeing=0.1, shape=(13, 13)),
)

#: The regimes by name.
REGIMES = {regime.name: regime for regime in _ALL}
