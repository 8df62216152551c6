"""Kinds of messy stars: their motions, their variability, and the table of all."""

from dataclasses import dataclass, fields
from functools import partial

import numpy as np

from scope_models._arrays import plain_number
from scope_models._values import Value
from scope_models.effects._noise import red_noise
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
        Its period, the mean time between flares, the full width of a bump at half its height, the
        time of a rise, or the correlation time of a random walk, days.
    amplitude : float, optional
        About half its relative range; the depth of eclipses, the height of a bump or rise, the
        standard deviation of a random walk.
    depth, transit_period, duration : float, optional
        Relative depth, period (infinite for one transit) and duration of transits, days.
    neighbors : tuple of (float, float, float), optional
        Magnitude difference, distance (px) and amplitude of a 1.1-d variability of each neighbor.
    focus, focus_period : float, optional
        Largest relative change of the PSF's width, and its period, days.
    seeing : float, optional
        Standard deviation of relative changes of the width, correlated over 1 h.
    background : float, optional
        Background that the file's own subtraction leaves, e-/s per pixel.
    shape : tuple of int, optional
        Rows and columns.
    cosmic_rays : float, optional
        Share of all values that hold a cosmic ray in a long cadence; about 0.025 in two K2 files
        of faint stars.
    cadence : float, optional
        Time from cadence to cadence, days.
    longest, lost : int, optional
        Most cadences of a star, and those without a flag in which the star is off the stamp.
    positions : {"wrong", "none"}, optional
        As in `make_sky`.
    apart : bool, optional
        Whether the star is scored apart, as its slow variability under slow motion cannot be found
        in its pixels alone.

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
# Two minutes.
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


def _roll(rng, time):
    """Sawtooth of 6 h along a short arc, whose sense reverses, and a slow drift."""
    span = time[-1]
    reversal = rng.uniform(0.25, 0.75) * span
    rate = 1.5 * rng.uniform(0.6, 1.3) * np.sin(np.pi * (reversal - time) / 35)
    period = 0.2452
    roll, firing = np.empty(len(time)), np.zeros(len(time), bool)
    angle, last, speed = rng.normal(0, 0.1), 0, 1.0
    for i, now in enumerate(time):
        step = now - time[i - 1] if i else 0.0
        angle += rate[i] * speed * step
        if int(now / period) > last:
            last = int(now / period)
            if abs(angle) > 0.1:
                angle, speed = rng.normal(0, 0.06), rng.normal(1, 0.15)
                firing[i] = True
        roll[i] = angle
    direction = rng.uniform(0, 2 * np.pi)
    along = roll + 0.003 * red_noise(rng, time, 0.06)
    drift = rng.normal(0, 0.05, 2) * (time / span - 0.5)[:, None]
    across = 0.03 * roll**2 + 0.002 * rng.normal(size=len(time))
    c, s = np.cos(direction), np.sin(direction)
    return c * along - s * across + drift[:, 0], s * along + c * across + drift[:, 1], firing


def _drift(rng, time):
    """Velocity aberration, the wheels' temperature every 3 d, and jitter."""
    phase = time / time[-1] - 0.5
    offsets = []
    for _ in range(2):
        slope, bend = rng.normal(0, 0.25), rng.normal(0, 0.1)
        heater = rng.uniform(0.001, 0.004) * np.sin(2 * np.pi * time / 3 + rng.uniform(0, 6))
        offsets.append(slope * phase + bend * phase**2 + heater + rng.normal(0, 4e-4, len(time)))
    return *offsets, np.zeros(len(time), bool)


def _orbits(rng, time):
    """Jitter, a drift within each orbit of 13.7 d, and momentum dumps."""
    dumps = 2.5 + 0.2 * rng.uniform()
    number = (time / dumps).astype(int)
    firing = np.diff(number, prepend=0) > 0
    offsets = []
    for _ in range(2):
        jumps = rng.normal(0, 0.01, number[-1] + 1)[number]
        orbit = rng.normal(0, 0.04) * ((time % 13.7) / 13.7 - 0.5) ** 2 * 4
        jitter = 0.006 * red_noise(rng, time, 0.08) + 0.004 * rng.normal(size=len(time))
        offsets.append(jumps + orbit + jitter)
    return *offsets, firing


def _walk(rng, time):
    return *(0.3 * red_noise(rng, time, 4.0) for _ in range(2)), np.zeros(len(time), bool)


def _wheels(rng, time):
    """Wheels that fail: a drift that grows, slow oscillations and jumps."""
    phase = time / time[-1]
    offsets = []
    jumps = np.sort(rng.uniform(0, time[-1], 8))
    firing = np.zeros(len(time), bool)
    firing[np.minimum(np.searchsorted(time, jumps), len(time) - 1)] = True
    for _ in range(2):
        level = np.concatenate([[0], rng.normal(0, 0.25, 8)])[np.searchsorted(jumps, time)]
        swing = 0.3 * phase**2 * np.sin(2 * np.pi * time / rng.uniform(0.7, 2) + rng.uniform(0, 6))
        drift = rng.normal(0, 0.4) * phase**2
        offsets.append(level * phase + swing + drift + 0.01 * red_noise(rng, time, 0.1))
    return *offsets, firing


def _jitter(rng, time, size=0.0035, slow=0.0035):
    """White noise and noise over hours, pixels."""
    white = rng.normal(0, size, (2, len(time)))
    return *(one + slow * red_noise(rng, time, 0.1) for one in white), np.zeros(len(time), bool)


#: Offsets in pixels along x and y, and the cadences in which thrusters fire, by the kind of motion.
#: Times are in days from the beginning.
MOTIONS = {
    "k2": _roll, "kepler": _drift, "tess": _orbits, "walk": _walk, "wheels": _wheels,
    "rest": partial(_jitter, size=1e-4, slow=0.0), "jitter": _jitter,
}  # fmt: skip


def _wave(rng, time, period):
    return np.sin(2 * np.pi * time / period + rng.uniform(0, 2 * np.pi))


def _spots(rng, time, period, amplitude):
    """Two groups of spots whose sizes evolve over several rotations."""
    values = np.zeros(len(time))
    for harmonic, part in ((1, 1.0), (2, 0.5)):
        angle = 2 * np.pi * harmonic * time / period + rng.uniform(0, 2 * np.pi)
        size = 1 + 0.4 * _smooth(rng, time, 2 * period)
        values += part * size * np.sin(angle + 0.4 * _smooth(rng, time, 3 * period))
    return 1 + amplitude * values


def _smooth(rng, time, scale):
    """Return a smooth process of about unit variance."""
    nodes = np.arange(-4 * scale, time[-1] + 5 * scale, scale)
    kernel = np.exp(-0.5 * ((time[:, None] - nodes) / scale) ** 2)
    return kernel @ rng.normal(size=len(nodes)) / np.sqrt((kernel**2).sum(axis=1))


def _rr_lyrae(rng, time, period, amplitude):
    """A steep rise and a slow decline."""
    phase = 2 * np.pi * (time / period + rng.uniform())
    harmonics = np.arange(1, 8)
    shape = (np.sin(np.outer(phase, harmonics)) / harmonics * 0.85**harmonics).sum(axis=1)
    return 1 + amplitude * shape / np.ptp(shape) * 2


def _delta_scuti(rng, time, period, amplitude):
    values = np.zeros(len(time))
    for part in (1.0, 0.6, 0.4, 0.2):
        values += part * _wave(rng, time, period * rng.uniform(0.7, 1.4))
    return 1 + amplitude * values / 2.2


def _eclipsing(rng, time, period, amplitude):
    """Two eclipses of soft shape, and ellipsoidal variations."""
    phase = (time / period + rng.uniform()) % 1
    half = 0.035 * rng.uniform(0.8, 1.5)
    primary = _dip((phase + 0.5) % 1 - 0.5, half)
    secondary = _dip(phase - 0.5, half)
    ellipsoidal = 0.01 * np.cos(4 * np.pi * phase)
    return (1 - amplitude * primary - 0.4 * amplitude * secondary) * (1 - ellipsoidal)


def _dip(x, half):
    """Return a dip of depth 1 with soft shoulders."""
    return np.clip(1.5 * (1 - np.abs(x / half) ** 2.5), 0, 1)


def _flaring(rng, time, period, amplitude):
    """Fast rises with exponential decays, one every `period` days, and weak spots."""
    values = _spots(rng, time, 3.7, 0.002)
    for _ in range(rng.poisson(time[-1] / period) + 1):
        since = time - rng.uniform(0, time[-1])
        decay = rng.uniform(0.02, 0.08)
        values += amplitude * rng.pareto(1.5) * 0.5 * (since > 0) * np.exp(-np.abs(since) / decay)
    return np.minimum(values, 2.0)


def _bump(rng, time, period, amplitude):
    since = (time - rng.uniform(0.3, 0.7) * time[-1]) / period
    return 1 + amplitude * np.exp(-4 * np.log(2) * since**2)


def _rise(rng, time, period, amplitude):
    """One smooth rise that begins on the first day."""
    phase = np.clip((time - rng.uniform()) / period, 0, 1)
    return 1 + amplitude * np.sin(np.pi / 2 * phase) ** 2


#: Relative flux of a star without transits, near 1, by the kind of variability: functions of time,
#: period and amplitude as in `SkyRegime`.
LIGHTS = {
    "constant": lambda rng, time, period, amplitude: np.ones(len(time)),  # noqa: ARG005
    "sine": lambda rng, time, period, amplitude: 1 + amplitude * _wave(rng, time, period),
    "walk": lambda rng, time, period, amplitude: 1 + amplitude * red_noise(rng, time, period),
    "spots": _spots, "rr_lyrae": _rr_lyrae, "delta_scuti": _delta_scuti, "eclipsing": _eclipsing,
    "flaring": _flaring, "bump": _bump, "rise": _rise,
}  # fmt: skip


def make_transit(rng, time, period, duration):
    """Return the shape of transits, 0 outside and 1 at most; period and duration are in days."""
    phase = rng.uniform(0.35, 0.65)
    if np.isinf(period):  # a single one
        since = time - phase * time[-1]
    else:
        since = (time - phase * period + period / 2) % period - period / 2
    return np.clip(1.3 * (1 - np.abs(2 * since / duration) ** 4), 0, 1)
