import copy
import pickle

import astropy.units as u
import numpy as np
import pytest
from astropy.io import fits
from astropy.table import Table
from scipy.spatial.distance import pdist

from scope_models.scene import _pointing as _roll
from scope_models.scene.motion import K2Roll, Motion

THRUSTER_FIRING = 1048576
FILES = [
    "k2_tpf/ktwo211956421-c05_lpd-targ.fits.gz",
    "k2_tpf/ktwo211983544-c18_lpd-targ.fits.gz",
    "kepler_tpf/kplr009002278-2010174085026_lpd-targ.fits.gz",
    "tess_tpf/tesssip_tpf1.fits",
    "poscorr/epic205998445_c03_poscorr.fits",
    "poscorr/ktwo206103150-c03_llc.fits",
    "poscorr/ktwo211117077-c04_llc.fits",
]


@pytest.fixture
def motion():
    rng = np.random.default_rng(3)
    n = 200
    return Motion(
        2144.0 + 0.02 * np.arange(n),
        *rng.normal(0, 0.2, (2, n)),
        rng.integers(0, 4, n),
        np.arange(500, 500 + n),
        meta={"mission": "K2"},
    )


# Arrays


def test_arrays_are_copied_read_only_and_typed():
    x = np.zeros(3, dtype=np.float32)
    motion = Motion([0, 1, 2], x, x)
    x[:] = 9
    assert np.all(motion.x == 0)
    types = {"time": float, "x": float, "y": float, "quality": np.int32, "cadenceno": np.int32}
    for name, kind in types.items():
        values = getattr(motion, name)
        assert values.dtype == kind
        with pytest.raises(ValueError, match="read-only"):
            values[0] = 1
    assert np.array_equal(motion.cadenceno, [1, 2, 3])
    with pytest.raises(AttributeError):
        motion.x = x
    with pytest.raises(TypeError):
        motion.meta["mission"] = "none"


def test_pickle_and_copy(motion):
    for twin in (pickle.loads(pickle.dumps(motion)), copy.deepcopy(motion)):  # noqa: S301
        for name in ("time", "x", "y", "quality", "cadenceno"):
            assert np.array_equal(getattr(twin, name), getattr(motion, name))
        assert not twin.x.flags.writeable
        assert dict(twin.meta) == dict(motion.meta)
        assert twin == motion
        assert hash(twin) == hash(motion)
        assert twin != 2 * motion


@pytest.mark.parametrize(
    "changes, error, match",
    [
        ({"time": [], "x": [], "y": []}, ValueError, "`time` is empty"),
        ({"x": [1.0]}, ValueError, "`x` must have the length of `time`, 3, got 1"),
        ({"quality": [1]}, ValueError, "`quality` must have the length of `time`"),
        ({"x": np.zeros((3, 1))}, ValueError, "`x` must be one-dimensional"),
        ({"time": 3.0, "x": 0.0, "y": 0.0}, ValueError, "`time` must be one-dimensional"),
        ({"y": [0.0, np.nan, 0.0]}, ValueError, "`y` must be finite, got nan"),
        ({"x": ["a", "b", "c"]}, TypeError, "`x` must hold numbers"),
        ({"time": [0.0, 2.0, 1.0]}, ValueError, "`time` must increase strictly, got 1.0 after 2.0"),
        ({"time": [0.0, 1.0, 1.0]}, ValueError, "`time` must increase strictly"),
        ({"cadenceno": [3, 2, 1]}, ValueError, "`cadenceno` must increase strictly"),
        ({"quality": [0.5, 0, 0]}, TypeError, "`quality` must hold integers"),
        ({"quality": [2**40, 0, 0]}, ValueError, "`quality` must fit into 32 bits"),
        ({"time_format": "jd"}, ValueError, "`time_format` must be one of bkjd, btjd, got 'jd'"),
    ],
)
def test_refused_arrays(changes, error, match):
    values = {"time": [0.0, 1.0, 2.0], "x": np.zeros(3), "y": np.zeros(3), **changes}
    with pytest.raises(error, match=match):
        Motion(**values)
    if "nan" not in match:
        with pytest.raises(error, match=match):
            Motion.from_arrays(**values)


# Unusable values


def test_interpolated_in_cadence_number_and_flagged():
    number = [1, 2, 4, 5, 9, 10]
    x = np.array([0.1, 0.2, 0.4, -548.1, 0.9, np.inf])
    y = -np.array(number, dtype=float)
    time = np.array([0.1, np.nan, 0.4, 0.5, 0.9, 1.0])
    motion = Motion.from_arrays(time, x, y, [0, 8, 0, 1, 0, 0], cadenceno=number)
    # A straight line in cadence number between usable neighbors; the last position stays.
    assert motion.x == pytest.approx([0.1, 0.2, 0.4, 0.5, 0.9, 0.9], abs=1e-15)
    assert motion.y == pytest.approx([-1, -2, -4, -5, -9, -9], abs=1e-15)
    assert motion.time == pytest.approx(np.array(number) / 10, abs=1e-15)
    assert np.array_equal(motion.quality, [0, 8 | 65536, 0, 1 | 256, 0, 256])
    assert motion.meta["n_bad"] == 3


@pytest.mark.parametrize("time_format", ["bkjd", "btjd"])
def test_flags_are_rejected_by_lightkurves_default_mask(time_format):
    from lightkurve.utils import KeplerQualityFlags, TessQualityFlags

    flags = {"bkjd": KeplerQualityFlags, "btjd": TessQualityFlags}[time_format]
    motion = Motion.from_arrays(
        [0, np.nan, 2, 3], [0, 0, np.nan, 0], np.zeros(4), time_format=time_format
    )
    good = flags.create_quality_mask(motion.quality, bitmask="default")
    assert np.array_equal(good, [True, False, False, True])
    assert "Manual exclude" in flags.decode(motion.quality[2])


def test_times_go_on_at_the_ends():
    time = [np.nan, np.nan, 0.3, 0.4, 0.5, np.nan]
    motion = Motion.from_arrays(time, np.zeros(6), np.zeros(6))
    assert motion.time == pytest.approx(0.1 * np.arange(1, 7), abs=1e-12)


def test_drop():
    motion = Motion.from_arrays(
        [0, 1, np.nan, 3], [0, -60.0, 0, 0.3], np.zeros(4), [0, 1, 2, 3], bad="drop"
    )
    assert np.array_equal(motion.time, [0, 3])
    assert np.array_equal(motion.quality, [0, 3])
    assert np.array_equal(motion.cadenceno, [1, 4])


def test_limit_is_50_px():
    offsets = [0, 49.999, 50.0, -50.0]
    motion = Motion.from_arrays(np.arange(4), np.zeros(4), offsets)
    assert np.array_equal(motion.quality, [0, 0, 256, 256])


@pytest.mark.parametrize(
    "time, x, bad, match",
    [
        ([0, 1, 2], [0, 99, np.nan], "error", "2 positions are NaN .* 0 times are NaN.* index 1"),
        ([0, 1, 2], [99, 99, 99], "interpolate", "no usable position: all of 3"),
        ([0, 1, 2], [np.nan] * 3, "drop", "no usable position"),
        ([np.nan] * 3, [0, 0, 0], "interpolate", "no usable time"),
        ([np.nan, 1, 2], [0, 99, 99], "drop", "no cadence with both"),
        ([np.nan, 1, np.nan], [0, 0, 0], "interpolate", "at least two usable values"),
        ([0, np.nan, 0], [0, 0, 0], "interpolate", "`time` must increase strictly"),
        ([0, 1, 2], [0, 0, 0], "ignore", "`bad` must be one of interpolate, drop, error"),
    ],
)
def test_refused_values(time, x, bad, match):
    with pytest.raises(ValueError, match=match):
        Motion.from_arrays(time, x, np.zeros(3), bad=bad)


# Files


@pytest.mark.parametrize("name", FILES)
def test_real_files(shared_data, name):
    motion = Motion.from_file(shared_data / name)
    raw = fits.getdata(shared_data / name, 1)
    assert len(motion) == len(raw)
    x, y = (np.asarray(raw[c], dtype=float) for c in ("POS_CORR1", "POS_CORR2"))
    good = (np.abs(x) < 50) & (np.abs(y) < 50)
    timed = np.isfinite(raw["TIME"])
    assert np.array_equal(motion.x[good], x[good])
    assert np.array_equal(motion.y[good], y[good])
    assert np.array_equal(motion.time[timed], raw["TIME"][timed])
    assert np.all(np.abs(motion.x) <= np.abs(x[good]).max())
    steps = np.diff(motion.time) / np.diff(motion.cadenceno)
    if "poscorr.fits" not in name:
        assert np.ptp(steps) < 2e-3 * np.median(steps)  # also where times were interpolated
        assert np.array_equal(motion.cadenceno, raw["CADENCENO"])
        quality = raw["SAP_QUALITY" if "llc" in name else "QUALITY"]
        excluded = 128 if "tess" in name else 256
        assert np.all(motion.quality[~good] & excluded)
        assert np.all(motion.quality[~timed] & 65536)
        assert np.array_equal(motion.quality[good & timed], quality[good & timed])
    assert motion.time_format == ("btjd" if "tess" in name else "bkjd")
    assert motion.meta["filename"] == name.split("/")[1]


def test_real_unusable_values_are_there(shared_data):
    """The files hold what the repairs are for."""
    motion = Motion.from_file(shared_data / FILES[2])
    assert motion.meta["n_bad"] == 146
    assert motion.meta["object"] == "KIC 9002278"
    with pytest.raises(ValueError, match=r"lpd-targ\.fits\.gz: 146 positions are NaN"):
        Motion.from_file(shared_data / FILES[2], bad="error")
    assert len(Motion.from_file(shared_data / FILES[2], bad="drop")) == len(motion) - 146


@pytest.mark.parametrize("name", [FILES[0], FILES[3], FILES[5]])
def test_lightkurve_objects_give_what_their_files_give(shared_data, name):
    import lightkurve

    source = lightkurve.read(shared_data / name)
    motion = Motion.from_tpf(source)
    if isinstance(source, lightkurve.targetpixelfile.TargetPixelFile):
        source.hdu.close()
    whole = Motion.from_file(shared_data / name)
    chosen = np.isin(whole.cadenceno, motion.cadenceno)
    assert len(motion) > 0.85 * len(whole)
    for column in ("time", "quality", "cadenceno"):
        assert np.array_equal(getattr(motion, column), getattr(whole, column)[chosen])
    measured = (motion.quality & 256) == 0
    assert np.array_equal(motion.x[measured], whole.x[chosen][measured])
    assert np.array_equal(motion.y[measured], whole.y[chosen][measured])
    assert motion.time_format == whole.time_format


@pytest.mark.parametrize("name", FILES[:3])
def test_cadences_without_a_time_in_lightkurve_objects(shared_data, name):
    """lightkurve sets the times of such cadences to 0."""
    import lightkurve

    source = lightkurve.read(shared_data / name, quality_bitmask="none")
    assert np.any(source.time.value == 0)
    motion, part = Motion.from_tpf(source), Motion.from_tpf(source[90:1500])
    source.hdu.close()
    whole = Motion.from_file(shared_data / name)
    for column in ("time", "x", "y", "quality", "cadenceno"):
        assert np.array_equal(getattr(motion, column), getattr(whole, column))
        assert len(getattr(part, column)) == 1410
    assert np.array_equal(part.time[3:-3], whole.time[93:1497])
    facts = {key: value for key, value in whole.meta.items() if key != "filename"}
    assert motion.meta == pytest.approx(facts)


def test_objects_without_positions():
    from lightkurve import LightCurve

    with pytest.raises(TypeError, match=r"`tpf` must have .* POS_CORR1 .* LightCurve lacks them"):
        Motion.from_tpf(LightCurve(time=[1.0, 2.0], flux=[1.0, 1.0]))
    with pytest.raises(TypeError, match="but str lacks them"):
        Motion.from_tpf("file.fits")


def test_masked_values_of_light_curves_are_unusable():
    from astropy.utils.masked import Masked
    from lightkurve import LightCurve

    curve = LightCurve(time=[1.0, 2.0, 3.0], flux=[1.0, 1.0, 1.0])
    curve["pos_corr1"] = Masked([0.1, 7.0, 0.3] * u.pix, mask=[False, True, False])
    curve["pos_corr2"] = [0.0, 0.0, 0.0]
    motion = Motion.from_tpf(curve)
    assert motion.x == pytest.approx([0.1, 0.2, 0.3], abs=1e-15)
    assert np.array_equal(motion.quality, [0, 256, 0])


def test_file_without_position_columns(tmp_path):
    Table({"TIME": [1.0], "POS_CORR1": [0.0]}).write(tmp_path / "half.fits")
    with pytest.raises(ValueError, match=r"half\.fits has no column POS_CORR2"):
        Motion.from_file(tmp_path / "half.fits")


@pytest.mark.parametrize(
    "x, match",
    [([999.0, 999.0], "no usable position"), ([np.nan, np.nan], "no usable position")],
)
def test_unusable_file_is_named(tmp_path, x, match):
    columns = {"TIME": [1.0, 2.0], "POS_CORR1": x, "POS_CORR2": [0.0, 0.0]}
    Table(columns).write(tmp_path / "bad.fits")
    with pytest.raises(ValueError, match=rf"bad\.fits: {match}"):
        Motion.from_file(tmp_path / "bad.fits")


def test_time_format_can_be_told(tmp_path):
    columns = {"TIME": [1.0, 2.0], "POS_CORR1": [0.0, 0.0], "POS_CORR2": [0.0, 0.0]}
    Table(columns).write(tmp_path / "bare.fits")
    assert Motion.from_file(tmp_path / "bare.fits").time_format == "bkjd"
    assert Motion.from_file(tmp_path / "bare.fits", time_format="btjd").time_format == "btjd"


# Scaling, slicing, joining


@pytest.mark.parametrize("factor", [5, 0.5, -1, 0, np.float64(2), np.int64(3), 2 * u.one])
def test_scaling(motion, factor):
    for scaled in (factor * motion, motion * factor):
        assert np.array_equal(scaled.x, float(factor) * motion.x)
        assert np.array_equal(scaled.y, float(factor) * motion.y)
        assert np.array_equal(scaled.time, motion.time)
    assert (2 * (3 * motion)).meta["scale"] == 6


def test_refused_scales(motion):
    for factor in ("2", np.ones(200), True, None, 2 * u.pix, motion):
        with pytest.raises(
            TypeError, match=r"unsupported operand|must be str|can't multiply|sequence"
        ):
            factor * motion
    with pytest.raises(ValueError, match="must be finite, got nan"):
        np.nan * motion


@pytest.mark.parametrize(
    "item", [slice(50), slice(10, 100, 7), slice(-20, None), 17, -1, [3, 5, 100], np.int32(4)]
)
def test_slicing(motion, item):
    part = motion[item]
    for name in ("time", "x", "y", "quality", "cadenceno"):
        assert np.array_equal(getattr(part, name), np.atleast_1d(getattr(motion, name)[item]))
    assert part.meta == motion.meta


def test_masks_and_wrong_indices(motion):
    mask = motion.quality == 0
    assert np.array_equal(motion[mask].x, motion.x[mask])
    with pytest.raises(IndexError, match="boolean index did not match"):
        motion[mask[:-1]]
    with pytest.raises(IndexError, match="index 200 is out of bounds"):
        motion[200]
    with pytest.raises(ValueError, match="`time` is empty"):
        motion[5:5]
    with pytest.raises(ValueError, match="must increase strictly"):
        motion[::-1]
    assert [len(cadence) for cadence in motion[:3]] == [1, 1, 1]


def test_joining(motion):
    joined = motion[:70] + motion[70:]
    for name in ("time", "x", "y", "quality", "cadenceno"):
        assert np.array_equal(getattr(joined, name), getattr(motion, name))
    assert joined.meta == motion.meta
    twice = Motion.concatenate([motion, 3 * motion], shift=True)
    assert np.array_equal(twice.x, np.concatenate([motion.x, 3 * motion.x]))
    assert np.diff(twice.time) == pytest.approx(np.full(399, 0.02), abs=1e-9)
    assert np.array_equal(np.diff(twice.cadenceno), np.ones(399))
    assert dict(twice.meta) == {"mission": "K2"}
    single = Motion.concatenate([motion[0], motion[0]], shift=True)
    assert single.time[1] - single.time[0] == pytest.approx(0.0204336, abs=1e-6)


def test_refused_joins(motion):
    with pytest.raises(ValueError, match=r"must increase .*shift=True"):
        motion + motion
    with pytest.raises(ValueError, match="must have one time format"):
        Motion.concatenate([motion, Motion([9999.0], [0], [0], time_format="btjd")])
    with pytest.raises(ValueError, match="`motions` is empty"):
        Motion.concatenate([])
    with pytest.raises(TypeError, match="unsupported operand"):
        motion + 1


def test_still():
    motion = Motion.still(10, start=5.0, cadence=0.5, time_format="btjd")
    assert np.array_equal(motion.time, 5 + 0.5 * np.arange(10))
    assert not motion.x.any()
    assert not motion.y.any()
    assert motion.statistics().extent == 0 * u.pix
    with pytest.raises(ValueError, match="`n_cadences` must be at least 1, got 0"):
        Motion.still(0)
    with pytest.raises(TypeError, match="`n_cadences` must be an integer"):
        Motion.still(3.0)
    with pytest.raises(ValueError, match="`cadence` must be positive"):
        Motion.still(3, cadence=0)


def test_repr(motion):
    assert "200 cadences, BKJD 2144.0000 to 2147.98" in repr(motion)


# Statistics


def test_statistics_of_the_papers_star(shared_data):
    motion = Motion.from_file(shared_data / "poscorr/epic205998445_c03_poscorr.fits")
    row = motion.statistics(pixel_scale=3.98)
    assert row.n_cadences == 500
    assert row.mean.to_value(u.pix) == pytest.approx(0.177, abs=5e-4)
    assert row.std.to_value(u.pix) == pytest.approx(0.124, abs=5e-4)
    assert row.maximum.to_value(u.pix) == pytest.approx(0.579, abs=5e-4)
    assert row.extent.to_value(u.pix) == pytest.approx(0.81, abs=5e-3)
    assert row.in_arcsec().maximum.to_value(u.arcsec) == pytest.approx(0.579 * 3.98, abs=2e-3)


def test_statistics_scale(motion):
    row, larger = motion.statistics(), (-3 * motion).statistics()
    for name in ("mean", "std", "maximum", "extent"):
        value = getattr(larger, name).to_value(u.pix)
        assert value == pytest.approx(3 * getattr(row, name).to_value(u.pix), rel=1e-12)


def test_statistics_exclude_flagged_cadences(motion):
    row = motion.statistics(exclude=1)
    assert row.n_cadences == np.sum(motion.quality & 1 == 0)
    with pytest.raises(ValueError, match="all cadences have quality flags"):
        Motion([0], [0], [0], [1]).statistics(exclude=3)
    with pytest.raises(ValueError, match="`pixel_scale` must be positive"):
        motion.statistics(pixel_scale=0)


def test_statistics_as_table_and_text(motion):
    row = motion.statistics(4.0)
    table = row.to_table()
    assert table["mean"].unit == u.pix
    assert table["pixel_scale"].unit == u.arcsec / u.pix
    assert str(row.in_arcsec()).endswith("arcsec")
    assert row.in_arcsec().in_arcsec() == row.in_arcsec()


def _point_sets():
    rng = np.random.default_rng(8)
    angle = 2 * np.pi * np.arange(36) / 36
    grid = np.mgrid[:5, :3].reshape(2, -1).astype(float)
    yield from rng.normal(size=(20, 2, 50))
    yield rng.normal(size=(2, 3))
    yield np.array([np.cos(angle), np.sin(angle)])
    yield np.array([np.cos(angle), 0.01 * np.sin(angle)])
    yield grid
    yield np.array([grid[0] + grid[1], grid[0] - grid[1]])
    yield np.array([[0.0, 1.0, 5.0], [0.0, 2.0, 10.0]])
    yield np.array([[0.0, 1.0], [0.0, 1.0]])
    yield np.full((2, 7), 0.3)
    yield np.array([[0.3], [0.4]])


@pytest.mark.parametrize("points", list(_point_sets()))
def test_extent_is_the_largest_of_all_pairs(points):
    row = Motion(np.arange(points.shape[1]), *points).statistics()
    expected = pdist(points.T).max() if points.shape[1] > 1 else 0.0
    assert row.extent.to_value(u.pix) == pytest.approx(expected, rel=1e-12, abs=1e-15)


# The generator


def test_default_has_the_row_of_the_paper():
    motion = Motion.k2_roll()
    assert len(motion) == 1000
    for exclude in (0, THRUSTER_FIRING):
        row = motion.statistics(exclude=exclude)
        assert row.mean.value == pytest.approx(0.17, rel=0.05)
        assert row.std.value == pytest.approx(0.12, rel=0.05)
        assert row.maximum.value == pytest.approx(0.59, rel=0.05)


def test_row_of_the_paper_is_typical_of_the_parameters():
    """The parameters, not the seed, make the size of the motion."""
    rows = [Motion.k2_roll(seed=seed).statistics() for seed in range(40)]
    for name, expected in {"mean": 0.17, "std": 0.12, "maximum": 0.59}.items():
        values = np.array([getattr(row, name).value for row in rows])
        assert values.mean() == pytest.approx(expected, rel=0.10)


@pytest.mark.parametrize("n", [1, 37, 500])
def test_prefix_of_a_longer_series(n):
    short, long = Motion.k2_roll(n), Motion.k2_roll(1000)
    for name in ("time", "x", "y", "quality", "cadenceno"):
        assert np.allclose(getattr(short, name), getattr(long, name)[:n], rtol=0, atol=1e-12)


def test_seeds():
    same, other = Motion.k2_roll(300, seed=4), Motion.k2_roll(300, seed=5)
    assert np.array_equal(same.x, Motion.k2_roll(300, seed=4).x)
    assert not np.array_equal(same.x, other.x)
    fresh = Motion.k2_roll(300, seed=None)
    assert np.array_equal(Motion.k2_roll(300, seed=fresh.meta["seed"]).x, fresh.x)


def test_spectrum_peaks_at_four_cycles_per_day():
    motion = Motion.k2_roll(3456)
    frequency = np.fft.rfftfreq(3456, np.median(np.diff(motion.time)))
    steps = np.diff(motion.y, prepend=motion.y[0])
    power = np.abs(np.fft.rfft(steps - steps.mean())) ** 2
    band = (frequency > 3) & (frequency < 6)
    peak = frequency[band][np.argmax(power[band])]
    assert peak == pytest.approx(24 / 5.885, abs=0.05)
    near = np.abs(frequency - 24 / 5.885) < 0.1
    aside = band & (np.abs(frequency - 24 / 5.885) > 0.5)
    assert power[near].max() > 20 * np.median(power[aside])


def _drift(motion, first, last):
    """Return the median rate of y in px per cadence, without resets."""
    days = motion.time - motion.time[0]
    return np.median(np.diff(motion.y[(days >= first) & (days < last)]))


def test_sense_of_roll_reverses():
    motion = Motion.k2_roll(2400)
    before, after, back = _drift(motion, 0, 5), _drift(motion, 20, 35), _drift(motion, 46, 49)
    assert before < -0.01
    assert after > 0.02
    assert back < 0
    other = Motion.k2_roll(1000, reversal=15.0)
    assert _drift(other, 9.5, 14) < 0 < _drift(motion, 9.5, 14)


def test_drift_rate_is_that_of_sunlight():
    """Without scatter the rate is the arm times the sine, twice it from the second reversal on."""
    motion = Motion.k2_roll(3600, field=(4.0, 0.0), rate_scatter=0, rate_growth=0, roll_jitter=0)
    clean = ~np.convolve(motion.quality > 0, np.ones(3), mode="same").astype(bool)
    rate = np.gradient(motion.y)[clean]
    day = (motion.time - motion.time[0])[clean]
    arm = np.radians(4.0) * 206264.806 / 3.98
    expected = arm / 206264.806 * 3.0 * (0.0204336 * 24) * np.sin(np.pi * (9.4 - day) / 35.0)
    expected[day > 9.4 + 35.0] *= 2
    assert rate == pytest.approx(expected, abs=6 * 0.0036 / 3.98)


def test_displacement_is_arm_times_angle():
    """Stars of one field share one roll angle."""
    settings = {"pointing_jitter": 0.0, "orbital_speed": 0.0, "seed": 6}
    star = Motion.k2_roll(400, field=(3.0, -1.0), **settings)
    farther = Motion.k2_roll(400, field=(6.0, -2.0), **settings)
    turned = Motion.k2_roll(400, field=(1.0, 3.0), **settings)
    coarse = Motion.k2_roll(400, field=(3.0, -1.0), pixel_scale=2 * 3.98, **settings)
    assert farther.x == pytest.approx(2 * star.x, abs=1e-14)
    assert farther.y == pytest.approx(2 * star.y, abs=1e-14)
    assert turned.x == pytest.approx(-star.y, abs=1e-14)
    assert turned.y == pytest.approx(star.x, abs=1e-14)
    assert coarse.x == pytest.approx(star.x / 2, abs=1e-14)
    assert star.x * 3.0 == pytest.approx(-star.y * -1.0, abs=1e-14)  # across the arm


def test_aberration_moves_along_the_arm():
    settings = {"solar_rate": 0, "reset_scatter": 0, "roll_jitter": 0, "pointing_jitter": 0}
    motion = Motion.k2_roll(3900, field=(5.0, 0.0), **settings)
    arm = 5.0 * 3600 / 3.98
    assert not motion.y.any()
    assert abs(motion.x.mean()) < 1e-3
    expected = arm * 29.8 / 299792.458 * (1 - np.cos(2 * np.pi * 40 / 365.25))
    assert np.ptp(motion.x) == pytest.approx(expected, rel=0.01)
    assert np.argmax(motion.x) * 0.0204336 == pytest.approx(40, abs=0.1)


def test_pointing_jitter_alone():
    motion = Motion.k2_roll(4000, field=(0, 0), pointing_jitter=0.5, pixel_scale=2.0)
    # The standard deviation of 4000 normal numbers is known to 1.1 %.
    assert np.std(motion.x) == pytest.approx(0.25, rel=0.045)
    assert np.std(motion.y) == pytest.approx(0.25, rel=0.045)
    assert abs(np.corrcoef(motion.x, motion.y)[0, 1]) < 0.06


def test_roll_jitter_has_its_width_and_memory():
    settings = {"solar_rate": 0, "reset_scatter": 0, "pointing_jitter": 0, "orbital_speed": 0}
    motion = Motion.k2_roll(20000, field=(5.0, 0.0), roll_jitter=2.0, **settings)
    angle = motion.y / (5.0 * 3600 / 3.98) * 206264.806
    # About 20000 / 6 independent numbers: 1.2 %.
    assert np.std(angle) == pytest.approx(2.0, rel=0.05)
    lag = 3
    correlation = np.mean(angle[lag:] * angle[:-lag]) / np.var(angle)
    assert correlation == pytest.approx(np.exp(-lag * 0.0204336 * 24 / 1.5), abs=0.05)


def test_firings_are_where_the_jumps_are():
    motion = Motion.k2_roll(3400, roll_jitter=0, pointing_jitter=0)
    steps = np.diff(motion.y)
    jumps = np.abs(steps - np.median(steps)) > 0.15
    firing = (motion.quality & THRUSTER_FIRING) > 0
    touched = firing[1:] | firing[:-1]
    assert jumps.sum() > 50
    assert np.all(touched[jumps])
    gaps = np.diff(np.flatnonzero(firing))
    multiples = np.round(gaps[gaps > 1] / 11.99)
    # Real firings are 12, 24, 36... cadences apart, now and then one less.
    assert np.all(np.abs(gaps[gaps > 1] - 12 * multiples) <= 2)
    assert np.mean(multiples == 1) > 0.4
    assert 0.01 < np.mean(gaps == 1) < 0.15
    # A firing cadence lies between the two sides of the jump, but for half a cadence's drift.
    lone = np.flatnonzero(firing)[1:-1]
    lone = lone[~firing[lone - 1] & ~firing[lone + 1]]
    before, during, after = motion.y[lone - 1], motion.y[lone], motion.y[lone + 1]
    low, high = np.minimum(before, after) - 0.05, np.maximum(before, after) + 0.05
    assert np.all((during > low) & (during < high))


def test_number_of_firings_is_that_of_real_files(shared_data):
    """Real firing rates per cadence: 0.040 to 0.054 in campaigns 3, 4, 5 and 18."""
    real = [
        np.mean((Motion.from_file(shared_data / name).quality & THRUSTER_FIRING) > 0)
        for name in (FILES[0], FILES[1], FILES[5], FILES[6])
    ]
    generated = [np.mean(Motion.k2_roll(3400, seed=seed).quality > 0) for seed in range(5)]
    assert 0.8 * min(real) < np.mean(generated) < 1.2 * max(real)


def test_power_spectrum_is_that_of_the_real_series(shared_data):
    """In each octave of frequency the power is within a factor 2 of WASP-47's whole campaign."""

    def octaves(motion):
        along = 0.877 * motion.x - 0.480 * motion.y
        power = np.abs(np.fft.rfft((along - along.mean()) * np.hanning(len(along)))) ** 2
        frequency = np.fft.rfftfreq(len(along), 0.0204336)
        lows = 0.2 * 2.0 ** np.arange(7)
        return [power[(frequency >= low) & (frequency < 2 * low)].mean() for low in lows]

    real = Motion.from_file(shared_data / FILES[5])
    generated = [
        octaves(Motion.k2_roll(len(real), field=(-2.61, -4.77), seed=seed)) for seed in range(6)
    ]
    ratio = np.mean(generated, axis=0) / octaves(real)
    assert np.all((ratio > 0.5) & (ratio < 2))


def test_means_over_cadences_are_exact():
    """Against sums over 2000 points per cadence of the same piecewise quadratic."""
    times = np.array([-3.0, 0.7, 2.1, 2.4, 6.0])
    state = np.random.default_rng(2).normal(size=(5, 3))
    edges = np.linspace(0, 10, 21)
    fine = (np.arange(20 * 2000) + 0.5) / 4000
    piece = np.searchsorted(times, fine, side="right") - 1
    tau = fine - times[piece]
    angle, omega, alpha = state[piece].T
    expected = (angle + omega * tau + alpha * tau**2 / 2).reshape(20, 2000).mean(axis=1)
    assert _roll.cadence_means(times, state, edges) == pytest.approx(expected, abs=1e-3)


@pytest.mark.parametrize(
    "name",
    [
        "rate_growth",
        "rate_scatter",
        "reset_jitter",
        "deadband",
        "reset_scatter",
        "roll_jitter",
        "roll_jitter_time",
        "pointing_jitter",
    ],
)
def test_numbers_that_must_not_be_negative(name):
    with pytest.raises(ValueError, match=f"`{name}` must not be negative, got -1.0"):
        Motion.k2_roll(10, **{name: -1})
    assert len(Motion.k2_roll(50, **{name: 0})) == 50


@pytest.mark.parametrize("name", ["reversal_interval", "reset_interval", "campaign", "pixel_scale"])
def test_numbers_that_must_be_positive(name):
    for value in (0, -2.0):
        with pytest.raises(ValueError, match=f"`{name}` must be positive"):
            Motion.k2_roll(10, **{name: value})


@pytest.mark.parametrize(
    "parameters, error, match",
    [
        ({"field": 3.0}, TypeError, r"`field` must be \(column, row\), got 3.0"),
        ({"field": (1.0, np.nan)}, ValueError, "`field` must be finite, got nan"),
        ({"reversal": np.inf}, ValueError, "`reversal` must be finite"),
        ({"solar_rate": "fast"}, TypeError, "`solar_rate` must be a number"),
        ({"position": (1, 1)}, TypeError, "unexpected keyword argument 'position'"),
        ({"seed": 1.5}, TypeError, "`seed` must be an integer"),
        ({"seed": -1}, ValueError, "`seed` must be at least 0"),
        ({"n_cadences": 0}, ValueError, "`n_cadences` must be at least 1, got 0"),
        ({"n_cadences": 10.0}, TypeError, "`n_cadences` must be an integer"),
    ],
)
def test_refused_parameters(parameters, error, match):
    with pytest.raises(error, match=match):
        Motion.k2_roll(**parameters)


def test_generator_is_told_in_meta():
    motion = Motion.k2_roll(20, deadband=20.0)
    generator = dict(motion.meta["generator"])
    assert generator.pop("name") == "K2Roll"
    assert K2Roll(**generator) == K2Roll(deadband=20.0)
    assert pickle.loads(pickle.dumps(motion)).meta["seed"] == motion.meta["seed"]  # noqa: S301
