"""The class methods of `Motion` that generate motions."""

from dataclasses import asdict

import astropy.units as u
import numpy as np

from scope_models._arrays import plain_time
from scope_models._checks import checked_integer, checked_number
from scope_models._docstrings import documented
from scope_models.effects.noise import check_seed, fresh_seed, stream
from scope_models.missions import MISSIONS
from scope_models.scene._k2_roll import K2Campaign18, K2FinalCampaign, K2Roll
from scope_models.scene._motion_arrays import check_time_format
from scope_models.scene._pointing import (
    FailingWheels,
    GroundTracking,
    KeplerPointing,
    RandomWalk,
    TESSPointing,
)

__all__ = [
    "failing_wheels",
    "ground",
    "k2_final_campaign",
    "k2_roll",
    "kepler",
    "random_walk",
    "still",
    "tess",
]

_KEPLER, _K2, _TESS = (MISSIONS[name] for name in ("Kepler", "K2", "TESS"))
_LAST = {18: K2Campaign18, 19: K2FinalCampaign}
_CADENCE = """cadence : float or Quantity, optional
    Time between cadences, {unit}."""
# What all generators have in common, from the seed on.
_REST = """seed : int or None, optional
    Seed of all random numbers; None takes a new one, which ``meta["seed"]`` holds.
start : float, Quantity or Time, optional
    Time of the first cadence, {zero}; {start}.
**parameters
    Fields of {kind} that differ from their defaults.

Returns
-------
Motion
    The motion.

Raises
------
TypeError, ValueError
    If an argument is of the wrong kind or out of its range.
"""


def _rest(kind, zero="BKJD", start="by default that of a campaign of the mission"):
    return _REST.format(kind=f"`~scope_models.scene.motion.{kind}`", zero=zero, start=start)


def _first(start, time_format):
    """Return the time of a first cadence in days."""
    check_time_format(time_format)
    days = plain_time(start, time_format, "start")
    if days.ndim or not np.isfinite(days):
        raise ValueError(f"`start` must be one finite time, got {start!r}")
    return float(days)


def _generated(cls, pointing, n_cadences, days, mission, start, seed, **options):
    """Return the motion of a pointing."""
    name, seed = type(pointing).__name__, fresh_seed() if seed is None else check_seed(seed)
    time = pointing.times(checked_integer("n_cadences", n_cadences, 1), days)
    x, y, flags = pointing.track(time, lambda part: stream(seed, f"{name} {part}"), **options)
    quality = np.zeros(len(time), dtype=np.int32)
    for meaning, cadences in flags.items():
        quality[cadences] |= getattr(mission.quality, meaning)
    meta = {"mission": mission.name, "generator": {"name": name, **asdict(pointing)}, "seed": seed}
    time = _first(start, mission.time_format) + time
    return cls(time, x, y, quality, time_format=mission.time_format, meta=meta)


def still(cls, n_cadences, *, start=_K2.start, cadence=K2Roll.cadence, time_format="bkjd"):
    """Make a motion that stays at the reference position.

    Parameters
    ----------
    n_cadences : int
        Number of cadences.
    start : float, Quantity or Time, optional
        Time of the first cadence in days; the default is the beginning of K2 campaign 3.
    cadence : float or Quantity, optional
        Time between cadences in days; the default is Kepler's long cadence.
    time_format : {"bkjd", "btjd"}, optional
        Zero of the times.

    Returns
    -------
    Motion
        The motion.

    Raises
    ------
    ValueError
        If the number or the cadence is not positive.

    Examples
    --------
    >>> from scope_models import Motion
    >>> Motion.still(3).x
    array([0., 0., 0.])
    """
    n = checked_integer("n_cadences", n_cadences, 1)
    cadence = checked_number("cadence", cadence, u.day, positive=True)
    time = _first(start, time_format) + cadence * np.arange(n)
    return cls(time, np.zeros(n), np.zeros(n), time_format=time_format)


@documented(rest=_rest("K2Roll", start="the default is the beginning of campaign 3"))
def k2_roll(cls, n_cadences=1000, *, seed=10, start=_K2.start, **parameters):
    """Generate the motion of a K2 star while the spacecraft rolls about its boresight.

    The parameters' defaults describe EPIC 205998445 in campaign 3, and
    `~scope_models.scene.motion.K2Roll` gives their sources. No series is rescaled to given
    statistics; the default seed is the first one for which the 1000 cadences of the paper [1]_
    have its row, 0.17 +- 0.12 px and at most 0.59 px, within 5 %. Cadences in which thrusters
    fire have the quality flag 1048576.

    Parameters
    ----------
    n_cadences : int, optional
        Number of long cadences. A longer series begins like a shorter one.
    {rest}

    References
    ----------
    .. [1] Saunders, N. et al., "The Pointing Limits of Transiting Exoplanet Light Curve
       Characterization with Pixel Level De-correlation", table 1.

    Examples
    --------
    >>> from scope_models import Motion
    >>> print(Motion.k2_roll().statistics())
    0.170 +- 0.118 px, max 0.595 px, extent 1.07 px
    >>> edge = Motion.k2_roll(field=(6.94, 0.0))
    >>> print(edge.statistics())
    0.247 +- 0.171 px, max 0.862 px, extent 1.56 px
    """
    n = checked_integer("n_cadences", n_cadences, 1)
    roll = K2Roll(**parameters)
    seed = fresh_seed() if seed is None else check_seed(seed)
    x, y, firing = roll.track(n, lambda name: stream(seed, f"k2_roll {name}"))
    time = _first(start, "bkjd") + roll.cadence * np.arange(n)
    quality = np.where(firing, _K2.quality.thruster_firing, 0)
    meta = {"mission": "K2", "generator": asdict(roll), "seed": seed}
    return cls(time, x, y, quality, meta=meta)


@documented(rest=_rest("KeplerPointing"))
def kepler(cls, n_cadences=4500, *, cadence="long", seed=1, start=_KEPLER.start, **parameters):
    """Generate the motion of a Kepler star over a quarter.

    Compared with Kepler-62 in quarter 5 (4634 cadences): range along columns and rows 0.123 and
    0.092 px there, 0.122 and 0.090 px here; robust scatter about a running median of 49
    cadences 0.00022 and 0.00020 px there, 0.00024 and 0.00027 px here.

    Parameters
    ----------
    n_cadences : int, optional
        Number of cadences; a quarter has about 4500 long ones.
    cadence : str, float or Quantity, optional
        A cadence of Kepler, by its name or length in seconds.
    {rest}

    Examples
    --------
    >>> from scope_models import Motion
    >>> motion = Motion.kepler(500)
    >>> bool(abs(motion.x).max() < 0.2)
    True
    """
    days = _KEPLER.cadence_days(cadence)
    return _generated(cls, KeplerPointing(**parameters), n_cadences, days, _KEPLER, start, seed)


@documented(rest=_rest("TESSPointing", "BTJD"))
def tess(cls, n_cadences=None, *, cadence="120 s", seed=1, start=_TESS.start, **parameters):
    """Generate the motion of a TESS star over a sector of two orbits.

    Compared with TIC 273589987 in sector 15 (100 cadences of 120 s): scatter along columns and
    rows 0.0027 and 0.0051 px there and here, correlation from one cadence to the next -0.31
    there and here.

    Parameters
    ----------
    n_cadences : int, optional
        Number of cadences; the default is a sector.
    cadence : str, float or Quantity, optional
        A cadence of TESS, by its name or length in seconds.
    {rest}

    Examples
    --------
    >>> from scope_models import Motion
    >>> motion = Motion.tess(cadence="1800 s")
    >>> len(motion), motion.time_format
    (1268, 'btjd')
    """
    pointing, days = TESSPointing(**parameters), _TESS.cadence_days(cadence)
    n = 2 * round(pointing.orbit_time / days) if n_cadences is None else n_cadences
    return _generated(cls, pointing, n, days, _TESS, start, seed, cadence=days)


@documented(rest=_rest("K2FinalCampaign`, or `~scope_models.scene.motion.K2Campaign18"))
def k2_final_campaign(cls, n_cadences=None, *, campaign=19, seed=1, start=None, **parameters):
    """Generate the motion of a star in one of K2's last campaigns.

    Campaign 19 compared with the K2 data release notes: 26.4 d in 1291 long cadences; 8.4 d off
    target, 7 d with less than 1.5 px, here less than 1 px, and 11 d of erratic pointing.

    Campaign 18 compared with EPIC 211983544 (2490 long cadences, without flagged ones): the
    motion along the direction of roll has the standard deviation 0.171 px there, 0.135 to 0.156
    px here (20 seeds); the median step from one cadence to the next is 0.0115 px there, 0.013
    px here; 101 cadences are flagged as with thruster firings there, 111 to 132 here. Cadences have
    the mission's numbers.

    Parameters
    ----------
    n_cadences : int, optional
        Number of long cadences; the default is the whole campaign.
    campaign : {18, 19}, optional
        The campaign.
    {rest}

    Examples
    --------
    >>> from scope_models import Motion
    >>> motion = Motion.k2_final_campaign()
    >>> nominal = motion[(motion.cadenceno >= 167743) & (motion.cadenceno <= 168097)]
    >>> bool(nominal.statistics().maximum.value < 1.5)
    True
    >>> print(Motion.k2_final_campaign(campaign=18).statistics(exclude=4))
    0.131 +- 0.090 px, max 0.623 px, extent 0.97 px
    """
    if campaign not in _LAST:
        raise ValueError(f"`campaign` must be 18 or 19, got {campaign!r}")
    pointing = _LAST[campaign](**parameters)
    first, every = pointing.cadences
    n = every if n_cadences is None else n_cadences
    start = pointing.start if start is None else start
    motion = _generated(cls, pointing, n, K2Roll.cadence, _K2, start, seed)
    return motion.replace(
        cadenceno=first + np.arange(len(motion)), meta={**motion.meta, "campaign": campaign}
    )


@documented(cadence=_CADENCE.format(unit="s"), rest=_rest("GroundTracking", "BTJD"))
def ground(cls, n_cadences=1000, *, cadence=60.0, seed=1, start=_TESS.start, **parameters):
    """Generate the motion of a star on a ground-based telescope, night by night.

    The image motion is that of the seeing and the aperture; pointing, drift and wind are assumed.

    Parameters
    ----------
    n_cadences : int, optional
        Number of exposures.
    {cadence}
    {rest}

    Examples
    --------
    >>> from scope_models import Motion
    >>> motion = Motion.ground(1000, cadence=60.0, night=6.0)
    >>> print(f"{motion.time[360] - motion.time[359]:.2f}")
    0.75
    """
    days = checked_number("cadence", cadence, u.s, positive=True) / 86400
    return _generated(cls, GroundTracking(**parameters), n_cadences, days, _TESS, start, seed)


@documented(cadence=_CADENCE.format(unit="days"), rest=_rest("RandomWalk"))
def random_walk(
    cls, n_cadences=1000, *, cadence=K2Roll.cadence, seed=1, start=_K2.start, **parameters
):
    """Generate a random walk, to test what corrects motions; it is no mission's motion.

    Parameters
    ----------
    n_cadences : int, optional
        Number of cadences. A longer series begins like a shorter one.
    {cadence}
    {rest}

    Examples
    --------
    >>> from scope_models import Motion
    >>> len(Motion.random_walk(100))
    100
    """
    days = checked_number("cadence", cadence, u.day, positive=True)
    return _generated(cls, RandomWalk(**parameters), n_cadences, days, _K2, start, seed)


@documented(cadence=_CADENCE.format(unit="days"), rest=_rest("FailingWheels"))
def failing_wheels(
    cls, n_cadences=1000, *, cadence=K2Roll.cadence, seed=1, start=_K2.start, **parameters
):
    """Generate a drift with growing jumps, to test what corrects motions; it is no mission's.

    Parameters
    ----------
    n_cadences : int, optional
        Number of cadences. A longer series begins like a shorter one.
    {cadence}
    {rest}

    Examples
    --------
    >>> from scope_models import Motion
    >>> len(Motion.failing_wheels(100))
    100
    """
    days = checked_number("cadence", cadence, u.day, positive=True)
    return _generated(cls, FailingWheels(**parameters), n_cadences, days, _K2, start, seed)
