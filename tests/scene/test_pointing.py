"""Generated motions against the missions' numbers, and motions as tables and figures."""

import astropy.units as u
import matplotlib.pyplot as plt
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.stats import mad_std
from astropy.table import QTable
from scipy.ndimage import median_filter
from scipy.signal import periodogram

from scope_models import MISSIONS, Detector, Motion, Star, simulate
from scope_models.scene.motion import GroundTracking, KeplerPointing, TESSPointing

GENERATORS = {
    "kepler": 400,
    "tess": 400,
    "k2_final_campaign": 1291,
    "ground": 400,
    "random_walk": 400,
    "failing_wheels": 400,
}


@pytest.mark.parametrize("name", GENERATORS)
def test_seeds_decide(name):
    make = getattr(Motion, name)
    first, again, other = make(50, seed=3), make(50, seed=3), make(50, seed=4)
    assert first == again
    assert not np.array_equal(first.x, other.x)
    fresh = make(50, seed=None)
    assert make(50, seed=fresh.meta["seed"]) == fresh
    with pytest.raises(ValueError, match="`n_cadences` must be at least 1"):
        make(0)
    with pytest.raises(TypeError, match="misspelled"):
        make(5, misspelled=1.0)


@pytest.mark.parametrize("name", ["tess", "k2_final_campaign", "random_walk", "failing_wheels"])
def test_a_longer_series_begins_like_a_shorter_one(name):
    make = getattr(Motion, name)
    long, short = make(300, seed=2), make(100, seed=2)
    np.testing.assert_allclose(long.x[:100], short.x, rtol=0, atol=1e-12)
    assert np.array_equal(long.quality[:100], short.quality)


def scatter(values):
    """Return the robust scatter about a running median of 49 cadences."""
    left = values - median_filter(values, 49)
    return mad_std(left)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_kepler_moves_as_kepler_62_did(shared_data, seed):
    real = Motion.from_file(
        shared_data / "kepler_tpf/kplr009002278-2010174085026_lpd-targ.fits.gz", bad="drop"
    )
    real = real[real.quality & MISSIONS["Kepler"].quality.rejected == 0]
    made = Motion.kepler(4634, seed=seed)
    assert np.ptp(made.time) == pytest.approx(np.ptp(real.time), rel=0.01)
    for axis in "xy":
        ours, theirs = getattr(made, axis), getattr(real, axis)
        assert np.ptp(ours) == pytest.approx(np.ptp(theirs), rel=0.2)
        assert scatter(ours) == pytest.approx(scatter(theirs), rel=0.4)
    dumps = made.time[made.quality & MISSIONS["Kepler"].quality.desaturation > 0]
    assert np.diff(dumps) == pytest.approx(2.98, abs=0.03)


def test_aberration_of_kepler_is_that_of_its_orbit():
    """The drift alone: the projected speed over that of light times the distance."""
    still = {"drift": 0.0, "jitter": 0.0, "heater": 0.0}
    motion = Motion.kepler(4500, field=(6.0, 0.0), latitude=0.0, phase=0.0, **still)
    turn = 2 * np.pi * (motion.time[-1] - motion.time[0]) / 365.25
    expected = 29.8 / 299792.458 * (1 - np.cos(turn)) * 6 * 3600 / 3.98
    assert np.ptp(motion.x) == pytest.approx(expected, rel=1e-9)
    assert np.all(motion.y == 0)


def test_tess_moves_as_its_file(shared_data):
    real = Motion.from_file(shared_data / "tess_tpf/tesssip_tpf1.fits", bad="drop")
    made = Motion.tess(9000, field=(0, 0), drift=0.0, dump_offset=0.0)
    for axis in "xy":
        ours, theirs = getattr(made, axis), getattr(real, axis)
        smooth = np.polynomial.Polynomial.fit(real.time, theirs, 2)(real.time)
        left = theirs - smooth
        assert ours.std() == pytest.approx(left.std(), rel=0.1)
        assert np.corrcoef(ours[1:], ours[:-1])[0, 1] == pytest.approx(-0.31, abs=0.03)
        assert np.corrcoef(left[1:], left[:-1])[0, 1] == pytest.approx(-0.31, abs=0.1)


def test_sector_of_tess():
    motion = Motion.tess(cadence="600 s")
    steps = np.diff(motion.time)
    gaps = np.flatnonzero(steps > 0.1)
    assert len(gaps) == 1
    assert steps[gaps[0]] == pytest.approx(1.13 + 600 / 86400)
    assert motion.time[gaps[0]] - motion.time[0] == pytest.approx(13.2, abs=0.01)
    dumps = motion.time[motion.quality & MISSIONS["TESS"].quality.desaturation > 0]
    assert len(dumps) in {8, 9}
    assert motion.time_format == "btjd"
    # 29.8 km/s, a quarter of 27.5 d of the year from the middle, 6 deg = 1029 px
    still = TESSPointing(jitter=(0, 0), drift=0, dump_offset=0)
    x, _, _ = still.track(np.array([0.0, 27.53]), lambda _: np.random.default_rng(1))
    expected = 2 * 29.8 / 299792.458 * np.sin(2 * np.pi * 13.765 / 365.25) * 6 * 3600 / 21
    assert x[1] - x[0] == pytest.approx(expected, rel=1e-6)


def test_jitter_of_tess_falls_with_the_cadence():
    still = {"field": (0, 0), "drift": 0.0, "dump_offset": 0.0}
    fast = Motion.tess(4000, cadence="20 s", **still).x.std()
    slow = Motion.tess(4000, cadence="120 s", **still).x.std()
    assert fast / slow == pytest.approx(6**0.5, rel=0.05)


def test_last_campaign_of_k2_has_its_parts():
    motion = Motion.k2_final_campaign()
    bits = MISSIONS["K2"].quality
    days = motion.time - motion.time[0]
    assert days[-1] == pytest.approx(26.4, abs=0.05)
    assert (motion.cadenceno[0], motion.cadenceno[-1]) == (167333, 168623)
    distance = np.hypot(motion.x, motion.y)
    coarse = motion.quality & bits.coarse_point > 0
    # The parts of the release notes, by their cadence numbers.
    first, last = motion.cadenceno <= 167742, motion.cadenceno >= 168098
    nominal = ~first & ~last
    assert coarse[first].all()
    assert not coarse[nominal].any()
    assert distance[first].min() > 4
    assert distance[nominal].max() < 1.5
    assert 2 < np.sqrt(np.mean(distance[last] ** 2)) < 4.5
    assert 0.2 < coarse[last].mean() < 0.95
    fine = motion.quality & bits.no_fine_point == 0
    assert np.array_equal(fine, (motion.cadenceno >= 167743) & (motion.cadenceno <= 168481))
    # The roll walks too: across a field, stars move differently.
    other = Motion.k2_final_campaign(field=(4.59, -1.35))
    assert np.ptp((other.y - motion.y)[last]) > 2 * np.ptp((other.y - motion.y)[nominal])
    with pytest.raises(ValueError, match="`campaign` must be 18 or 19, got 17"):
        Motion.k2_final_campaign(campaign=17)


def test_campaign_18_moves_as_its_file(shared_data):
    real = Motion.from_file(shared_data / "k2_tpf/ktwo211983544-c18_lpd-targ.fits.gz")
    made = Motion.k2_final_campaign(campaign=18, seed=2)
    bits = MISSIONS["K2"].quality
    assert np.array_equal(made.cadenceno, real.cadenceno)
    np.testing.assert_allclose(made.time, real.time, atol=0.01)
    away = made.quality & bits.coarse_point > 0
    assert np.all(real.quality[away] & bits.coarse_point)
    dumps = [np.flatnonzero(m.quality & bits.desaturation) for m in (made, real)]
    assert all(np.all(np.abs(np.diff(d) - 96) <= 1) for d in dumps)
    firings = [np.sum(m.quality & bits.thruster_firing > 0) for m in (made, real)]
    assert firings[0] == pytest.approx(firings[1], rel=0.35)
    rejected = bits.coarse_point | bits.manual_exclude | bits.no_data
    spread, steps = [], []
    for motion in (made, real):
        kept = motion[motion.quality & rejected == 0]
        spread.append(np.sqrt(np.linalg.eigvalsh(np.cov(kept.x, kept.y))))
        steps.append(np.median(np.hypot(np.diff(kept.x), np.diff(kept.y))))
    np.testing.assert_allclose(spread[0], spread[1], rtol=0.3)
    assert steps[0] == pytest.approx(steps[1], rel=0.2)


def test_ground_in_nights():
    motion = Motion.ground(900, cadence=1 * u.min, night=5.0)
    night = np.floor(motion.time - motion.time[0] + 1e-9)
    assert np.array_equal(np.unique(night, return_counts=True)[1], [300, 300, 300])
    tracking = GroundTracking(aperture=1.0, seeing=1.0, wavelength=600.0)
    # 0.18 (600 nm / 1 m)^(1/3) (1 arcsec / 0.98)^(5/3) = (0.305 arcsec)^2
    assert tracking.image_motion == pytest.approx(0.305, abs=0.002)
    assert GroundTracking(aperture=8.0).image_motion == pytest.approx(
        tracking.image_motion * 8 ** (-1 / 6), rel=1e-9
    )


def test_shaking_on_the_ground_has_its_spectrum():
    options = {"pointing": 0.0, "drift": 0.0, "wind": 0.0, "night": 23.0, "pixel_scale": 0.5}
    power, variances = 0.0, []
    for seed in range(40):
        motion = Motion.ground(1024, cadence=60.0, seed=seed, **options)
        frequency, spectrum = periodogram(motion.x)
        power = power + spectrum
        variances.append(motion.x.var())
    slope = np.polyfit(np.log(frequency[3:400]), np.log(power[3:400]), 1)[0]
    assert slope == pytest.approx(-5 / 3, abs=0.05)
    expected = (GroundTracking().image_motion / 0.5) ** 2
    assert np.mean(variances) == pytest.approx(expected, rel=0.2)


def test_random_walk_spreads_with_the_root_of_time():
    ends = [
        Motion.random_walk(101, cadence=0.04, seed=seed, spread=0.1).x[-1] for seed in range(300)
    ]
    assert np.std(ends) == pytest.approx(0.2, rel=0.12)


def test_failing_wheels_drift_and_jump():
    motion = Motion.failing_wheels(2000, jump=0.5, drift=0.1, seed=5)
    jumps = motion.quality & MISSIONS["K2"].quality.coarse_point > 0
    days = np.ptp(motion.time)
    assert days / 2 * 0.5 < jumps.sum() < days / 2 * 2
    steps = np.hypot(np.diff(motion.x), np.diff(motion.y))
    assert np.median(steps[jumps[1:]]) > 10 * np.median(steps[~jumps[1:]])
    quiet = Motion.failing_wheels(2000, jump=0.0, spread=0.0, drift=0.1)
    assert np.hypot(quiet.x[-1], quiet.y[-1]) == pytest.approx(0.1 * days)


@pytest.mark.parametrize(
    "options, message",
    [
        ({"drift_time": 0.0}, "`drift_time` must be positive"),
        ({"jitter": -1.0}, "`jitter` must not be negative"),
        ({"drift": np.nan}, "`drift` must be finite"),
        ({"dump_interval": 0.0}, "`dump_interval` must be positive"),
    ],
)
def test_bad_parameters(options, message):
    with pytest.raises(ValueError, match=message):
        KeplerPointing(**options)


def test_bad_telescopes():
    with pytest.raises(ValueError, match="`aperture` must be positive, got 0"):
        GroundTracking(aperture=0.0)


def test_generated_motions_can_be_simulated():
    motion = Motion.tess(20)
    observation = simulate(Star(10.0), Detector.tess(shape=(9, 9)), motion, seed=1)
    assert observation.flux.shape == (20, 9, 9)


@pytest.mark.parametrize("name", [*GENERATORS, "k2_roll"])
def test_write_and_read(name, tmp_path):
    motion = getattr(Motion, name)(30, seed=2)
    path = motion.write(tmp_path / "motion.fits")
    assert Motion.read(path) == motion
    assert Motion.read(path).meta["seed"] == 2
    with pytest.raises(FileExistsError, match="exists"):
        motion.write(path)
    motion[:5].write(path, overwrite=True)
    assert len(Motion.read(path)) == 5


def test_tables_of_others_are_refused_or_converted(tmp_path):
    path = tmp_path / "motion.ecsv"
    motion = Motion.still(3)
    with pytest.raises(ValueError, match=r"`path` must end in .fits or .fits.gz, got .*\.ecsv"):
        motion.write(path)
    columns = {"time": (motion.time * u.day).to(u.hour), "x": motion.x * u.pix, "y": motion.y}
    flags = {"quality": motion.quality, "cadenceno": motion.cadenceno}
    table = QTable(columns | flags, meta={"time_format": "bkjd"})
    table.write(path, format="ascii.ecsv")
    np.testing.assert_allclose(Motion.read(path).time, motion.time)
    table.remove_column("x")
    table.write(path, format="ascii.ecsv", overwrite=True)
    with pytest.raises(ValueError, match=r"motion\.ecsv is not a table of a motion"):
        Motion.read(path)
    for text in ("no table", ""):
        path.write_text(text, encoding="utf-8")
        with pytest.raises(ValueError, match=r"motion\.ecsv is not a table of a motion"):
            Motion.read(path)
    with pytest.raises(FileNotFoundError):
        Motion.read(tmp_path / "absent.ecsv")


def test_motion_of_an_observation(tmp_path):
    motion = Motion.k2_roll(10, seed=1)
    observation = simulate(Star(12.0), Detector.k2(), motion, seed=1)
    assert Motion.read(observation.write(tmp_path / "star.fits")) == motion
    path = Detector.k2().write(tmp_path / "detector.fits")
    with pytest.raises(ValueError, match=r"detector\.fits"):
        Motion.read(path)
    with pytest.raises(ValueError, match=r"motion\.fits holds no detector that can be made"):
        Detector.read(motion.write(tmp_path / "motion.fits"))


@pytest.mark.parametrize("name", [*GENERATORS, "k2_roll"])
def test_every_motion_is_drawn(name):
    ax = getattr(Motion, name)(20, seed=2).plot()
    assert ax.get_xlabel() == "Column (pixel)"
    plt.close("all")


def test_plot():
    ax = Motion.tess(50).plot(title="TESS")
    assert ax.get_xlabel() == "Column (pixel)"
    assert ax.figure.axes[1].get_ylabel() == "Time (BTJD)"
    plt.close("all")


def test_tables_for_notebooks():
    html = Motion.k2_roll(100)._repr_html_()
    assert "<th>mission</th><td>K2</td>" in html
    assert "&lt;Motion of 100 cadences" in html
    html = Detector.tess()._repr_html_()
    assert "<td>1 e-/s at magnitude 20.44</td>" in html
    assert "<td>2 components</td>" in html
    assert "none" in Detector.k2(well_depth=None, psf=None, mission="a<b")._repr_html_()


# Boresights of the campaigns (K2 mission pages), deg
BORESIGHTS = {3: (336.6653, -11.0967), 4: (59.0759, 18.6606), 5: (130.1576, 16.8296)}
BORESIGHTS[18] = (130.1610, 16.8279)
# Days of the second reversal (docs/data/motion_files.ecsv; the first of campaign 5 is before it)
SECOND_REVERSAL = {3: 45.1, 4: 43.1, 5: 37.2, 18: 43.1}
ROLLING = [
    "poscorr/ktwo206103150-c03_llc.fits",
    "poscorr/ktwo211117077-c04_llc.fits",
    "poscorr/ktwo211436265-c05_llc.fits",
    "poscorr/ktwo211495446-c05_llc.fits",
    "k2_tpf/ktwo211956421-c05_lpd-targ.fits.gz",
    "k2_tpf/ktwo211983544-c18_lpd-targ.fits.gz",
]


def _roll_of(motion):
    """Return the good cadences of a motion, and their offsets along the roll."""
    bits = MISSIONS["K2"].quality
    motion = motion[motion.quality & (bits.rejected | bits.thruster_firing) == 0]
    offsets = np.column_stack([motion.x, motion.y])
    offsets -= np.median(offsets, axis=0)
    return motion, offsets @ np.linalg.svd(offsets, full_matrices=False)[2][0]


def _along_roll(motion, degrees):
    """Return the standard deviation along the roll, and of what is faster than a day, px/deg."""
    motion, along = _roll_of(motion)
    slow = [np.median(along[np.abs(motion.time - t) < 0.5]) for t in motion.time]
    return along.std() / degrees, (along - slow).std() / degrees


def _real_roll(path, cadences=None):
    """Return the amplitudes of a real star."""
    motion = Motion.from_file(path)
    star = SkyCoord(motion.meta["ra"], motion.meta["dec"], unit="deg")
    boresight = SkyCoord(*BORESIGHTS[motion.meta["campaign"]], unit="deg")
    return _along_roll(motion[:cadences], star.separation(boresight).deg)


def _made_roll(cadences):
    """Return the mean amplitudes of generated motions."""
    motions = (Motion.k2_roll(cadences, seed=seed) for seed in (1, 2, 3, 10))
    return np.mean([_along_roll(motion, 4.784) for motion in motions], axis=0)


def test_amplitude_of_the_roll_of_the_default_length(shared_data):
    """Of the first 1000 cadences of campaign 3, which the defaults describe."""
    real, made = _real_roll(shared_data / ROLLING[0], 1000), _made_roll(1000)
    np.testing.assert_allclose(real, [0.045, 0.030], atol=6e-4)
    np.testing.assert_allclose(made, [0.044, 0.030], atol=6e-4)


def test_amplitude_of_the_roll_over_campaigns(shared_data):
    real = [_real_roll(shared_data / name) for name in ROLLING]
    np.testing.assert_allclose(np.min(real, axis=0), [0.054, 0.033], atol=6e-4)
    np.testing.assert_allclose(np.max(real, axis=0), [0.070, 0.041], atol=6e-4)
    made = _made_roll(3600)
    np.testing.assert_allclose(made, [0.063, 0.038], atol=6e-4)
    np.testing.assert_allclose(made, np.mean(real, axis=0), rtol=0.05)


@pytest.mark.parametrize("name", ROLLING)
def test_real_rates_double_at_the_second_reversal(shared_data, name):
    """Median steps from 25 to 10 days before it, and from 3 to 18 days after it."""
    motion, along = _roll_of(Motion.from_file(shared_data / name))
    day = motion.time - motion.time[0] - SECOND_REVERSAL[motion.meta["campaign"]]
    one = np.diff(motion.cadenceno) == 1
    before, after = (
        np.median(np.diff(along)[one & (day[1:] > low) & (day[1:] < low + 15)]) for low in (-25, 3)
    )
    assert -2.5 < after / before < -1.9
