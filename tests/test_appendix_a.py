"""The paper's Appendix A as printed, and that its parts compose."""

import inspect
import itertools
from types import SimpleNamespace

import numpy as np
import pytest
from astropy.modeling.fitting import TRFLSQFitter
from matplotlib import pyplot as plt
from numpy.testing import assert_allclose, assert_array_equal

import scope_models as scope
from scope_models.exceptions import DetrendingWarning
from scope_models.models import BivariateGaussianPSF, TransitModel, stochastic_signal
from scope_models.photometry import cdpp, threshold_aperture

N = 300


@pytest.fixture(scope="module")
def star():
    return scope.generate_target(ncadences=N, seed=1)


@pytest.fixture(autouse=True)
def _no_figure_left():
    yield
    plt.close("all")


def _target(**options):
    return scope.generate_target(**({"ncadences": N, "seed": 1} | options))


def test_appendix_a_as_printed(monkeypatch):
    """Without a seed; the test alone fixes what the operating system would give."""
    monkeypatch.setattr("scope_models.appendix_a.fresh_seed", lambda: 1)
    star = scope.generate_target()
    assert star.targetpixelfile.shape == (1000, 7, 7)
    assert star.lightcurve.shape == (1000,)
    assert star.error.shape == (1000, 7, 7)
    star.add_transit(depth=0.01, per=15, dur=0.5, t0=5.0)
    star.add_variability(var_amp=0.005, freq=0.25)
    star.add_neighbor(magdiff=1.0, dist=1.7)
    star = scope.generate_target(transit=True, variable=True, neighbor=True)
    star.display_detector()
    with pytest.warns(DetrendingWarning, match="of other stars: depths and amplitudes are too"):
        corrected = star.detrend()
    assert np.isfinite(corrected.flux.value).any()


def test_options_of_the_paper_are_the_defaults():
    """What is printed in Appendix A is what happens without arguments."""
    one = _target(transit=True, variable=True, neighbor=True)
    two = _target().add_transit(depth=0.01, per=15, dur=0.5, t0=5.0)
    two.add_variability(var_amp=0.005, freq=0.25).add_neighbor(magdiff=1.0, dist=1.7)
    assert_array_equal(one.targetpixelfile, two.targetpixelfile)


def test_it_is_simulate_and_nothing_more(star):
    motion = scope.Motion.k2_roll(N)
    detector = scope.Detector.k2(shape=(7, 7))
    same = scope.simulate(scope.Star(12.0, 3, 3), detector, motion, seed=1)
    assert_array_equal(star.targetpixelfile, same.flux)
    assert_array_equal(star.error, same.flux_err)
    assert_array_equal(star.time, motion.time)


def test_seed(star):
    assert_array_equal(_target().targetpixelfile, star.targetpixelfile)
    assert np.any(_target(seed=2).targetpixelfile != star.targetpixelfile)
    new = scope.generate_target(ncadences=20)
    again = scope.generate_target(ncadences=20, seed=new.seed)
    assert_array_equal(new.targetpixelfile, again.targetpixelfile)


# -- options -------------------------------------------------------------------------------------


def test_magnitude_and_position():
    faint = _target(mag=14.5, coords=(2.0, 4.5), noise=False)
    bright = _target(mag=12, coords=(2.0, 4.5), noise=False)
    assert_allclose(bright.targetpixelfile.sum() / faint.targetpixelfile.sum(), 10, rtol=1e-6)
    image = _target(coords=(2.0, 4.5), noise=False, roll=0).targetpixelfile[0]
    y, x = np.mgrid[:7, :7]
    assert_allclose((x * image).sum() / image.sum(), 2.0, atol=0.02)
    assert_allclose((y * image).sum() / image.sum(), 4.5, atol=0.02)


def test_roll_scales_the_motion(star):
    double = _target(roll=2)
    assert_allclose(double.motion.x, 2 * star.motion.x)
    still = _target(roll=0, noise=False)
    assert_allclose(still.targetpixelfile, still.targetpixelfile[:1].repeat(N, axis=0), rtol=1e-6)


def test_size_and_background():
    star = scope.generate_target(apsize=9, ncadences=50, background_level=1000.0, seed=1)
    assert star.targetpixelfile.shape == (50, 9, 9)
    assert star.detector.background == 1000.0
    assert star.error[0, 0, 0] > _target(ncadences=50, apsize=9).error[0, 0, 0]


def test_no_sensitivity_variation_is_a_control():
    """Without it, a star that moves but stays on the stamp keeps its flux."""

    def scatter(**options):
        star = _target(roll=0.5, apsize=9, noise=False, **options)
        flux = star.targetpixelfile.sum(axis=(1, 2), dtype=float)
        return np.std(flux) / np.mean(flux)

    assert scatter(no_sensitivity_variation=True) < 1e-6
    assert scatter() > 1e-4


def test_motion_file(shared_data):
    path = shared_data / "poscorr" / "epic205998445_c03_poscorr.fits"
    star = scope.generate_target(tpf_path=path, seed=1)
    motion = scope.Motion.from_file(path)
    assert len(star.time) == len(motion) == 500
    assert_array_equal(star.motion.x, motion.x)
    assert len(scope.generate_target(tpf_path=path, ncadences=100, seed=1).time) == 100
    with pytest.raises(ValueError, match="`ncadences` must be at most 500, the length of the"):
        scope.generate_target(tpf_path=path, ncadences=501)


def test_detector_and_psf():
    psf = BivariateGaussianPSF(sigma_x=0.9, sigma_y=0.9)
    wide = _target(psf=psf, noise=False).targetpixelfile[0]
    assert wide.max() < _target(noise=False).targetpixelfile[0].max()
    tess = scope.generate_target(
        detector=scope.Detector.tess(), motion=scope.Motion.still(20, time_format="btjd"), seed=1
    )
    assert tess.to_tpf().mission.upper() == "TESS"


# -- EPIC numbers --------------------------------------------------------------------------------


def test_epic_number_is_downloaded(monkeypatch, star, tmp_path):
    """The archive is replaced: the name that is searched, and what is made of the file."""
    path = str(star.write(tmp_path / "star.fits"))
    names = []
    monkeypatch.setattr("scope_models.batch.find_files", lambda name: names.append(name) or (path,))
    copy = scope.generate_target(ID=205998445, seed=1)
    assert names == ["EPIC 205998445"]
    assert_allclose(copy.motion.x, star.motion.x, atol=1e-6)  # single precision in files


def test_epic_number_without_network(monkeypatch):
    lightkurve = pytest.importorskip("lightkurve")

    def search(*_, **__):
        raise OSError("no route to host")

    monkeypatch.setattr(lightkurve, "search_targetpixelfile", search)
    with pytest.raises(ConnectionError, match=r"EPIC 205998445 .* no route .* `tpf_path` takes a"):
        scope.generate_target(ID=205998445)


def test_unknown_epic_number(monkeypatch):
    lightkurve = pytest.importorskip("lightkurve")
    monkeypatch.setattr(lightkurve, "search_targetpixelfile", lambda _: [])
    with pytest.raises(ValueError, match="EPIC 7 is not a file, and no target pixel file was"):
        scope.generate_target(ID=7)


# -- effects -------------------------------------------------------------------------------------

EFFECTS = {
    "transit": lambda s: s.add_transit(depth=0.02, per=4, dur=0.3, t0=1),
    "planet 2": lambda s: s.add_transit(depth=0.005, per=2.5, dur=0.2, t0=0.5, b=0.4),
    "variability": lambda s: s.add_variability(var_amp=0.01, freq=2.0),
    "neighbor": lambda s: s.add_neighbor(magdiff=0.5, dist=2, angle=30),
    "neighbor 2": lambda s: s.add_neighbor(magdiff=3, position=(1, 5)),
    "neighbor 3": lambda s: s.add_neighbor(magdiff=2, dist=1.5, angle=-120),
    "signal": lambda s: s.add_signal(lambda time: 1 + 1e-3 * (time - time[0])),
}


def test_effects_compose_in_any_order():
    """Signals multiply, neighbors add up: the noise-free cube does not know the order."""
    names = ["transit", "variability", "neighbor", "neighbor 2"]
    cubes = []
    for order in itertools.permutations(names):
        target = scope.generate_target(ncadences=60, seed=1, noise=False)
        for name in order:
            EFFECTS[name](target)
        cubes.append(target.targetpixelfile)
    for cube in cubes[1:]:
        assert_allclose(cube, cubes[0], rtol=1e-6)


def test_effects_add_up_to_their_parts():
    """All of them: the star's cube times all signals, plus each neighbor's cube."""
    target = _target(noise=False)
    own = target.targetpixelfile.astype(float)
    signal = np.ones(N)
    for name in ("transit", "planet 2", "variability", "signal"):
        one = EFFECTS[name](_target(noise=False))
        signal *= one.targetpixelfile[:, 3, 3] / own[:, 3, 3]
    others = sum(
        EFFECTS[name](_target(noise=False)).targetpixelfile - own
        for name in ("neighbor", "neighbor 2", "neighbor 3")
    )
    for effect in EFFECTS.values():
        effect(target)
    assert_allclose(target.targetpixelfile, own * signal[:, None, None] + others, rtol=1e-5)
    assert len(target.transits) == 2
    assert len(target.neighbors) == 3


@pytest.mark.parametrize("name", EFFECTS)
def test_effects_leave_the_noise_of_the_rest(name, star):
    """Where the expected counts are those of before, so is the noise, to one electron."""
    changed = EFFECTS[name](_target())
    before, after = _target(noise=False), EFFECTS[name](_target(noise=False))
    same = before.targetpixelfile == after.targetpixelfile
    one_electron = 1.01 / star.detector.exposure_time
    assert_allclose(changed.targetpixelfile[same], star.targetpixelfile[same], atol=one_electron)
    moved = changed.targetpixelfile - star.targetpixelfile
    expected = after.targetpixelfile - before.targetpixelfile
    assert np.abs(expected).max() > 100
    assert_allclose(moved, expected, atol=6 * np.abs(changed.error - star.error).max() + 1)


def test_transit_has_depth_duration_and_time():
    target = _target(noise=False, roll=0).add_transit(depth=0.02, per=4, dur=0.3, t0=1.0)
    flux = target.lightcurve / target.lightcurve[0]
    since = target.time - target.time[0]
    inside = np.abs((since - 1 + 2) % 4 - 2) < 0.15 + target.detector.cadence_days / 2
    assert_allclose(flux[~inside], 1, atol=1e-6)
    assert (flux[np.abs(since - 1) < 0.13] < 0.999).all()
    assert_allclose(flux.min(), 0.98, atol=1e-4)
    assert abs(since[flux.argmin()] - 1) < target.detector.cadence_days


def test_variability_is_in_radians_per_day():
    target = _target(noise=False, roll=0).add_variability(var_amp=0.01, freq=2.0)
    flux = target.lightcurve / target.lightcurve[0]
    since = target.time - target.time[0]
    assert_allclose(flux, 1 + 0.01 * np.sin(2.0 * since), atol=1e-6)


def test_user_signals():
    array = 1 + 0.01 * np.random.default_rng(3).random(N)
    by_option = _target(signal=array, noise=False)
    by_method = _target(noise=False).add_signal(array)
    plain = _target(noise=False)
    assert_array_equal(by_option.targetpixelfile, by_method.targetpixelfile)
    ratio = by_option.lightcurve / plain.lightcurve
    assert_allclose(ratio, array, rtol=1e-6)


def test_stochastic_variability_raises_the_noise():
    quiet = scope.generate_target(roll=0, seed=1)
    noisy = scope.generate_target(roll=0, seed=1)
    noisy.add_signal(stochastic_signal(quiet.time, 100, seed=4))
    expected = np.hypot(quiet.estimate_cdpp(), 100)
    assert_allclose(noisy.estimate_cdpp(), expected, rtol=0.15)


def test_neighbor_distance_and_light():
    target = _target(noise=False, roll=0).add_neighbor(magdiff=1.5, dist=2.0)
    (neighbor,) = target.neighbors
    assert_allclose(np.hypot(neighbor.x_0 - 3, neighbor.y_0 - 3), 2.0)
    assert neighbor.mag == 13.5
    more = target.targetpixelfile - _target(noise=False, roll=0).targetpixelfile
    y, x = np.mgrid[:7, :7]
    image = more[0] / more[0].sum()
    assert_allclose([(x * image).sum(), (y * image).sum()], [neighbor.x_0, neighbor.y_0], atol=0.1)
    again = _target().add_neighbor(magdiff=1.5, dist=2.0)
    assert again.neighbors[0].x_0 == neighbor.x_0  # the seed's
    two = again.add_neighbor(magdiff=1.5, dist=2.0).neighbors
    assert two[0].x_0 != two[1].x_0


def test_dilution_by_an_unresolved_neighbor():
    """The depth in the light curve is that of the signal times 1 - contamination."""
    target = _target(noise=False, roll=0).add_transit(depth=0.02, per=50, dur=1, t0=2)
    target.add_neighbor(magdiff=0.0, dist=0.3, angle=10)
    depth = 1 - target.lightcurve.min() / target.lightcurve.max()
    assert 0.45 < target.contamination < 0.55
    assert_allclose(depth, 0.02 * (1 - target.contamination), rtol=0.01)
    assert _target().contamination == 0


def test_eclipsing_background_binary():
    """Own PSF, own eclipses: the star's light curve dips by the diluted depth."""
    target = _target(noise=False, roll=0)
    start = target.time[0]
    binary = TransitModel.from_depth_duration(0.4, 0.4, 3.0, start + 1.5)
    psf = BivariateGaussianPSF(sigma_x=0.6, sigma_y=0.6)
    target.add_neighbor(magdiff=2, dist=0.8, angle=45, psf=psf, signal=binary)
    depth = 1 - target.lightcurve.min() / target.lightcurve.max()
    own = _target(noise=False, roll=0).targetpixelfile[0, target.aperture].sum()
    assert_allclose(depth, 0.4 * (1 - own / target.lightcurve[0]), rtol=5e-3)
    assert_allclose(1 - own / target.lightcurve[0], 1 / (1 + 10**0.8), rtol=0.1)
    assert abs((target.time[target.lightcurve.argmin()] - start) % 3 - 1.5) < 0.05


# -- products ------------------------------------------------------------------------------------


def test_apertures():
    target = _target().add_neighbor(magdiff=0.0, dist=2.5, angle=0)
    default = target.aperture
    assert_array_equal(default, threshold_aperture(target._noise_free))
    masks = {
        name: target.create_aperture(name, **options)
        for name, options in {
            "threshold": {"threshold": 1000},
            "signal-to-noise": {},
            "contamination": {"min_fraction": 0.9},
            "circular": {"radius": 1.5},
        }.items()
    }
    for mask in masks.values():
        assert mask.shape == (7, 7)
        assert mask.dtype == bool
        assert mask[3, 3]
    assert masks["threshold"].sum() < default.sum()
    assert not masks["contamination"][3, 5]
    assert_array_equal(target.aperture, masks["circular"])
    expected = target.targetpixelfile[:, target.aperture].sum(axis=1)
    assert_allclose(target.lightcurve, expected, rtol=1e-5)


def test_lightkurve_products(star, tmp_path):
    lightkurve = pytest.importorskip("lightkurve")
    tpf = star.to_tpf(quality_bitmask="none")
    assert_array_equal(tpf.flux.value, star.targetpixelfile)
    lc = star.to_lightcurve(quality_bitmask="none")
    assert_allclose(lc.flux.value, star.lightcurve, rtol=1e-5)
    path = star.write(tmp_path / "star.fits")
    read = lightkurve.read(path, quality_bitmask="none")
    assert_array_equal(read.flux.value, star.targetpixelfile)
    read.hdu.close()
    with pytest.raises(OSError, match="exists"):
        star.write(path)


def test_aperture_and_contamination_are_in_the_file(tmp_path):
    target = _target().add_neighbor(magdiff=1, dist=1.5, angle=20)
    mask = target.create_aperture("circular", radius=1.6)
    tpf = target.to_tpf(quality_bitmask="none")
    assert_array_equal(tpf.pipeline_mask, mask)
    assert_allclose(tpf.hdu[1].header["CROWDSAP"], 1 - target.contamination, rtol=1e-6)
    own = _target(noise=False).targetpixelfile[:, mask].sum(axis=1)
    fraction = own.mean() / target.observation.truth.flux[0]
    assert_allclose(tpf.hdu[1].header["FLFRCSAP"], fraction, rtol=1e-6)
    truth = scope.read_truth(target.write(tmp_path / "star.fits"))
    both = _target(noise=False).add_neighbor(magdiff=1, dist=1.5, angle=20)
    expected = own / both.targetpixelfile[:, mask].sum(axis=1)
    assert_allclose(truth.table["TARGET_SHARE"], expected, rtol=1e-5)


def test_estimate_cdpp(star):
    assert_allclose(star.estimate_cdpp(), cdpp(star.lightcurve), rtol=1e-6)
    assert_allclose(
        star.estimate_cdpp(method="everest"), cdpp(star.lightcurve, method="everest"), rtol=1e-6
    )
    assert star.estimate_cdpp(star.to_lightcurve()) > 0


def test_detrend_lowers_the_noise_and_keeps_the_transit():
    target = scope.generate_target(seed=1, apsize=9).add_transit(depth=0.005, per=6, dur=0.4, t0=2)
    corrected = target.detrend()
    in_transit = target.transits[0](corrected.time.value) < 1
    flux = corrected.flux.value / np.median(corrected.flux.value)
    assert target.estimate_cdpp(corrected[~in_transit]) < target.estimate_cdpp()
    mid = target.transits[0](corrected.time.value) < 0.9955
    assert_allclose(1 - flux[mid].mean(), 0.005, rtol=0.1)


def test_figures_from_the_object():
    """Each draws the object's arrays, at sub-pixel resolution where there is one."""
    target = _target(transit=True, neighbor=True, noise=False)
    sensitivity, light, image = (ax.images[0].get_array() for ax in target.display_detector(10))
    assert sensitivity.shape == light.shape == (70, 70)
    pixels = (sensitivity * light).reshape(7, 10, 7, 10).mean(axis=(1, 3))
    assert_allclose(pixels, target.targetpixelfile[0], rtol=0.01, atol=50)
    assert_array_equal(image, target.targetpixelfile[0])
    assert_array_equal(target.display_aperture().images[0].get_array(), image)
    assert set(target.plot()) == {"image", "motion", "light curve"}
    model = target.plot_transit().lines[2].get_ydata()
    assert_allclose(1 - model.min(), 0.01 * (1 - target.contamination), rtol=0.01)
    target.animate(step=N // 2).to_jshtml()


def test_figures_after_detrending():
    target = _target(transit=True)
    corrected = target.detrend()
    flux = corrected.flux.value / np.nanmedian(corrected.flux.value)
    axes = target.plot()
    labels = " ".join(axes["light curve"].get_legend_handles_labels()[1])
    signal = 1 + (1 - target.contamination) * (target.observation.truth.relative_flux[0] - 1)
    noise = cdpp(SimpleNamespace(time=target.time, flux=target.lightcurve / signal))
    assert f"raw, CDPP {noise:.1f} ppm (lightkurve)" in labels
    drawn = axes["corrected"].lines[0].get_ydata()
    used = np.isin(target.time, corrected.time.value)
    assert_allclose(drawn[used], flux, rtol=1e-6)
    assert np.isnan(drawn[~used]).all()
    folded = target.plot_transit(window=40).lines[0].get_ydata()
    assert_allclose(np.sort(folded), np.sort(flux[np.isfinite(flux)])[-len(folded) :], atol=0.02)


# -- bad input -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "call, message",
    [
        (lambda s: s.add_transit(depth=0), "`depth` must be between 0 and 1, got 0"),
        (lambda s: s.add_transit(depth=1.0), "`depth` must be between 0 and 1, got 1.0"),
        (lambda s: s.add_transit(dur=0), "`dur` must be positive, got 0"),
        (lambda s: s.add_transit(per=0), "`per` must be positive, got 0"),
        (lambda s: s.add_transit(per=1, dur=0.6), "`duration` must be .* below half a period"),
        (lambda s: s.add_transit(t0=np.nan), "`t0` must be finite"),
        (lambda s: s.add_variability(var_amp=-1), "`var_amp` must be positive, got -1"),
        (lambda s: s.add_variability(var_amp=2), "`amplitude` must be at least 0 and below 1"),
        (lambda s: s.add_variability(freq=0), "`freq` must be positive, got 0"),
        (lambda s: s.add_signal(np.ones(3)), "`signal` must give one number for each"),
        (lambda s: s.add_signal(-np.ones(N)), "`signal` must not be negative"),
        (lambda s: s.add_neighbor(dist=30), "is off the stamp of 7 x 7 pixels"),
        (lambda s: s.add_neighbor(position=(3, 7)), "column 3.00, row 7.00 is off the stamp"),
        (lambda s: s.add_neighbor(dist=-1), "`dist` must not be negative"),
        (lambda s: s.add_neighbor(signal=np.ones(3)), "`signal` must give one number for each"),
        (lambda s: s.create_aperture("round"), "`method` must be .* got 'round'"),
        (lambda s: s.create_aperture(threshold=1e9), "no pixel exceeds `threshold`"),
        (lambda s: s.to_lightcurve(np.zeros((7, 7), bool)), "`aperture_mask` has no pixels"),
        (lambda s: s.to_lightcurve(np.ones((3, 7), bool)), r"mask of shape \(7, 7\)"),
        (lambda s: s.plot_transit(), "`number` must be below 0, the number of transits"),
        (lambda _: scope.generate_target(ncadences=0), "`ncadences` must be at least 1, got 0"),
        (lambda _: scope.generate_target(apsize=0), "`apsize` must be at least 1, got 0"),
        (lambda _: scope.generate_target(coords=(9, 3)), "`coords` must be on the stamp"),
        (lambda _: scope.generate_target(coords=(1,)), r"`coords` must be \(column, row\)"),
        (lambda _: scope.generate_target(mag=np.nan), "`mag` must be finite"),
        (
            lambda s: scope.generate_target(motion=s.motion, ncadences=N + 1),
            f"`ncadences` must be at most {N}, the length of the motion, got {N + 1}",
        ),
        (
            lambda s: scope.generate_target(motion=s.motion, ID=205998445),
            "only one of `motion`, `tpf_path` and `ID`",
        ),
        (lambda s: scope.Target(scope.Star(12), s.detector, s.motion), "must have a position"),
    ],
)
def test_bad_values(call, message, star):
    before = len(star.transits), len(star.neighbors), star.star, star._aperture
    with pytest.raises(ValueError, match=message):
        call(star)
    after = len(star.transits), len(star.neighbors), star.star, star._aperture
    assert after == before


@pytest.mark.parametrize(
    "call",
    [
        lambda _: scope.generate_target(magnitude=12),
        lambda s: s.add_transit(dpeth=0.01),
        lambda s: s.add_variability(amplitude=0.1),
        lambda s: s.add_neighbor(magdif=1),
        lambda s: s.create_aperture("circular", raduis=2),
        lambda s: s.detrend(ordr=2),
        lambda s: s.to_tpf(bitmask="none"),
    ],
)
def test_a_misspelt_option_is_an_error(call, star):
    with pytest.raises(TypeError, match="unexpected keyword argument"):
        call(star)


def test_wrong_kinds():
    with pytest.raises(TypeError, match="`motion` must be a Motion, got"):
        scope.generate_target(motion="file.fits")
    with pytest.raises(TypeError, match="`detector` must be a Detector, got 'K2'"):
        scope.generate_target(detector="K2")
    with pytest.raises(FileNotFoundError):
        scope.generate_target(tpf_path="nothing.fits")
    with pytest.raises(TypeError, match=r"`coords` must be \(column, row\), got 3"):
        scope.generate_target(coords=3)
    with pytest.raises(TypeError, match=r"`position` must be \(column, row\), got 3"):
        scope.generate_target(ncadences=5).add_neighbor(position=3)


def test_nothing_is_swallowed():
    """No option of the public functions is a catch-all but those that go on as they are."""
    parameters = inspect.signature(scope.generate_target).parameters.values()
    assert all(p.kind is not p.VAR_KEYWORD for p in parameters)


# -- the paper's claim ---------------------------------------------------------------------------


def _pulls_at_five_times_the_motion(seed):
    """Simulate, de-trend, fit a transit: offsets from the truth in units of the errors."""
    target = scope.generate_target(mag=12, roll=5, apsize=15, ncadences=1500, seed=seed)
    target.add_transit(depth=0.002, per=4.2, dur=0.25, t0=1.3, b=0.3)
    corrected = target.detrend()
    truth, time = target.transits[0], corrected.time.value
    good = np.isfinite(corrected.flux.value)
    flux = corrected.flux.value / np.median(corrected.flux.value[good & (truth(time) == 1)])
    noise = corrected.flux_err.value / np.median(corrected.flux.value[good])
    start = TransitModel.from_depth_duration(
        0.0015, 0.2, 4.2, truth.t0.value + 0.02, u1=0.4, u2=0.26, exposure_time=truth.exposure_time
    )
    start.inc.value = truth.inc.value
    for name in ("period", "inc", "ecc", "omega", "u1", "u2"):
        getattr(start, name).fixed = True
    fitter = TRFLSQFitter(calc_uncertainties=True)
    fit = fitter(start, time[good], flux[good], weights=1 / noise[good])
    assert fit.cov_matrix.param_names == ["t0", "rp", "a"]
    errors = np.sqrt(np.diag(fit.cov_matrix.cov_matrix))
    assert errors[1] < 0.01 * fit.rp.value
    assert_allclose(fit.depth, truth.depth, rtol=0.02)
    return [
        (getattr(fit, name).value - getattr(truth, name).value) / error
        for name, error in zip(fit.cov_matrix.param_names, errors, strict=True)
    ]


def test_transit_is_retrieved_at_five_times_the_motion():
    assert np.max(np.abs(_pulls_at_five_times_the_motion(seed=1))) < 4


@pytest.mark.slow
def test_transits_are_retrieved_within_their_errors():
    """Forty-eight pulls of sixteen stars: their spread is 1 within its own error (0.1)."""
    pulls = np.array([_pulls_at_five_times_the_motion(seed) for seed in range(16)])
    assert np.abs(pulls).max() < 4
    assert 0.7 < pulls.std() < 1.3
    assert np.all(np.abs(pulls.mean(axis=0)) < 3 / np.sqrt(16))


def test_edits_leave_nothing_old_behind():
    target = scope.generate_target(ncadences=60, seed=1)
    before, alone, light = target.targetpixelfile, target.contamination, target.detrend()
    assert target.observation is target.observation
    target.neighbors.append(scope.Star(12.0, 4.0, 3.0))
    assert target.contamination > alone == 0
    assert len(target.observation.stars) == 2
    assert not np.array_equal(target.targetpixelfile, before)
    assert target.scene not in target._corrected
    target.neighbors.clear()
    assert_array_equal(target.targetpixelfile, before)
    target.detector = target.detector.replace(background=1000.0)
    assert target.observation.flux_bkg.mean() == pytest.approx(1000, rel=0.01)
    target.seed, target.noise = 2, False
    assert target.observation.scene == target.scene
    assert (target.scene.seed, target.scene.noise) == (2, frozenset())
    assert target.detrend() is not light
