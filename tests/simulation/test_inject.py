"""Injection: the change of the light is exact, the noise is that of the photons, files open."""

import importlib
import io
import sys
from unittest.mock import Mock

import numpy as np
import pytest
from astropy import units as u

from scope_models import Detector, Motion, Star, TransitModel, read_scene, read_truth, simulate
from scope_models.batch import inject_file
from scope_models.effects import Background, Extinction, Focus, Throughput
from scope_models.io import read_pixels, read_tpf
from scope_models.io.tpf import write_hdulist
from scope_models.simulation import _light, inject

module = importlib.import_module("scope_models.simulation.inject")
N = 120


def observe(stars, n=N, motion=None, detector=None, **options):
    detector = Detector.k2(shape=(11, 11)) if detector is None else detector
    motion = Motion.k2_roll(n, seed=3) if motion is None else motion
    return simulate(stars, detector, motion, seed=1, **options)


@pytest.fixture(scope="module")
def planet():
    t0 = Motion.k2_roll(N).time[60]
    return TransitModel.from_depth_duration(0.01, 0.3, 10.0, t0, exposure_time=0.0204)


@pytest.fixture(scope="module")
def crowded():
    """Return an observation of a star with a neighbor that is far away, and one that is near."""
    return observe([Star(12.0, 3.5, 3.5), Star(12.5, 8.5, 8.5), Star(14.0, 4.5, 3.5)])


def flux_of(tpf):
    return tpf.flux.value.astype(float)


class TestLight:
    def test_depth_of_the_target_alone_comes_back(self, crowded, planet):
        tpf = crowded.to_tpf(quality_bitmask="none")
        change = flux_of(inject(tpf, planet, noise=False)) - flux_of(tpf)
        own = observe([crowded.stars[0]], noise=False, keep_model=True).truth.model
        signal = planet(crowded.time)
        inside = signal < 1
        assert inside.sum() > 10
        ratio = change.sum(axis=(1, 2)) / own.sum(axis=(1, 2))
        np.testing.assert_allclose(ratio[inside], signal[inside] - 1, rtol=1e-3)
        assert not change[~inside].any()

    def test_pixels_of_a_neighbor_are_unchanged(self, crowded, planet):
        tpf = crowded.to_tpf(quality_bitmask="none")
        injected = inject(tpf, planet, seed=1)
        assert np.array_equal(flux_of(injected)[:, 8:, 8:], flux_of(tpf)[:, 8:, 8:])

    def test_is_a_simulation_with_the_signal(self, crowded, planet):
        target, *others = crowded.stars
        tpf = observe(crowded.stars, noise=False).to_tpf(quality_bitmask="none")
        expected = observe([target.replace(signal=planet), *others], noise=False)
        np.testing.assert_allclose(
            flux_of(inject(tpf, planet, noise=False)), expected.flux, rtol=1e-6, atol=1e-3
        )

    def test_multiplies_a_signal_that_is_there(self, planet):
        wave = 1 + 0.1 * np.sin(np.arange(N) / 9)
        tpf = observe(Star(12.0, signal=wave), noise=False).to_tpf(quality_bitmask="none")
        both = observe(Star(12.0, signal=wave * planet(tpf.time.value)), noise=False)
        injected = inject(tpf, planet, noise=False)
        np.testing.assert_allclose(flux_of(injected), both.flux, rtol=1e-6, atol=1e-3)

    def test_share(self, crowded, planet):
        tpf = crowded.to_tpf(quality_bitmask="none")
        change = flux_of(inject(tpf, planet, 0.25, noise=False)) / flux_of(tpf) - 1
        expected = 0.25 * (planet(crowded.time) - 1)
        np.testing.assert_allclose(change, np.tile(expected[:, None, None], (11, 11)), atol=2e-7)

    def test_of_a_fit_is_that_of_its_scene(self, crowded, planet):
        class Fit:
            def scene(self):
                return crowded.scene

        tpf = crowded.to_tpf(quality_bitmask="none")
        np.testing.assert_array_equal(
            flux_of(inject(tpf, planet, Fit(), noise=False)),
            flux_of(inject(tpf, planet, noise=False)),
        )

    def test_scene_of_other_cadences_is_interpolated(self, planet):
        tpf = observe(Star(12.0), noise=False).to_tpf(quality_bitmask="none")
        scene = observe(Star(12.0), noise=False).scene
        some = scene.replace(motion=scene.motion[::2])
        one, other = (flux_of(inject(tpf, planet, s, noise=False)) for s in (scene, some))
        change = flux_of(tpf).sum(axis=(1, 2)) * (planet(tpf.time.value) - 1)
        np.testing.assert_allclose((one - flux_of(tpf)).sum(axis=(1, 2)), change, atol=0.01)
        np.testing.assert_allclose((other - flux_of(tpf)).sum(axis=(1, 2)), change, atol=2)

    def test_effects_of_a_scene_of_other_cadences_are_moved(self, planet):
        wide, dim = 1 + 0.02 * np.sin(np.arange(N) / 15), np.linspace(1.0, 0.9, N)
        effects = Focus(series=wide), Throughput(series=dim), Background(left=dim)
        tpf = observe(Star(12.0), noise=False, effects=effects).to_tpf(quality_bitmask="none")
        own = Extinction(airmass=np.linspace(1, 2, N))
        scene = read_scene(tpf)
        scene = scene.replace(detector=scene.detector.replace(effects=own))
        keep = np.delete(np.arange(N), [1, 40, 41, 100])
        some = scene.replace(
            motion=scene.motion[keep],
            effects=[e.at(scene.motion.time, scene.motion.time[keep]) for e in effects],
            detector=scene.detector.replace(effects=Extinction(airmass=own.airmass[keep])),
        )
        one, other = (flux_of(inject(tpf, planet, s, noise=False)) for s in (scene, some))
        np.testing.assert_allclose(other[keep], one[keep], rtol=1e-6)
        np.testing.assert_allclose(other, one, rtol=1e-4, atol=0.1)

    def test_whole_star(self, planet):
        detector = Detector.k2(shape=(11, 11)).without_sensitivity()
        new = Star(14.0, 6.2, 5.0, signal=planet)
        alone = observe(Star(12.0, 3.5, 3.5), noise=False, detector=detector)
        tpf = alone.to_tpf(quality_bitmask="none")
        both = observe([Star(12.0, 3.5, 3.5), new], noise=False, detector=detector)
        injected = inject(tpf, star=new, noise=False)
        np.testing.assert_allclose(flux_of(injected), both.flux, rtol=1e-6, atol=1e-3)
        np.testing.assert_array_equal(simulate(read_scene(injected)).flux, both.flux)
        del tpf.hdu["SCENE"]  # then the detector is the preset, with the response within the pixels
        added = flux_of(inject(tpf, star=new, noise=False)) - flux_of(tpf)
        np.testing.assert_allclose(added, both.flux - flux_of(tpf), atol=0.03 * added.max())


class TestNoise:
    @pytest.mark.parametrize("factor", [0.3, 1.8])
    def test_variance_is_that_of_the_photons_that_are_left(self, factor):
        motion = Motion.still(3000)
        tpf = observe(Star(12.0), n=3000, motion=motion).to_tpf(quality_bitmask="none")
        injected = inject(tpf, np.full(3000, factor), seed=5)
        expected = observe(Star(12.0, signal=np.full(3000, factor)), n=3000, motion=motion)
        residual = flux_of(injected) - expected.model()
        np.testing.assert_allclose(residual.std(axis=0), expected.flux_err[0], rtol=0.07)
        chi = residual / expected.flux_err
        assert np.mean(chi**2) == pytest.approx(1, abs=0.01)
        assert np.abs(chi.mean(axis=0)).max() < 4.5 / 3000**0.5
        np.testing.assert_allclose(injected.flux_err.value[:50], expected.flux_err[:50], rtol=1e-3)

    def test_share_dims_the_noise_with_the_light(self):
        motion = Motion.still(3000)
        tpf = observe(Star(12.0), n=3000, motion=motion).to_tpf(quality_bitmask="none")
        dimmed = inject(tpf, np.full(3000, 0.5), 1.0, seed=5)
        expected = observe(Star(12.0, signal=np.full(3000, 0.5)), n=3000, motion=motion)
        residual = flux_of(dimmed) - flux_of(dimmed).mean(axis=0)
        bright = expected.flux[0] > 1000
        ratio = residual.std(axis=0)[bright] / expected.flux_err[0][bright]
        np.testing.assert_allclose(ratio, 1, rtol=0.07)

    def test_background_that_is_left_stays(self):
        """Residuals are scaled; the background is none of them."""
        left, motion = Background(left=np.full(3000, 300.0)), Motion.still(3000)
        tpf = observe(Star(12.0), motion=motion, effects=left).to_tpf(quality_bitmask="none")
        dimmed = inject(tpf, np.full(3000, 0.5), seed=5)
        added = dimmed.hdu["INJECTED"].data["FLUX_ADDED"]
        drawn = (flux_of(dimmed) - flux_of(tpf) - added)[:, added[0] < -1]
        assert np.abs(drawn.mean(axis=0) / drawn.std(axis=0)).max() < 4.5 / 3000**0.5

    def test_seed(self, crowded, planet):
        tpf = crowded.to_tpf(quality_bitmask="none")
        one, same, other = (flux_of(inject(tpf, planet, seed=seed)) for seed in (1, 1, 2))
        assert np.array_equal(one, same)
        assert not np.array_equal(one, other)

    def test_original_is_not_changed(self, crowded, planet):
        tpf = crowded.to_tpf(quality_bitmask="none")
        before = flux_of(tpf)
        inject(tpf, planet, seed=1)
        assert np.array_equal(before, flux_of(tpf))

    def test_errors_that_are_unknown(self, crowded, planet):
        tpf = crowded.to_tpf(quality_bitmask="none")
        expected = flux_of(inject(tpf, planet, noise=False))
        brighter = 2 - planet(crowded.time)
        tpf.hdu[1].data["FLUX_ERR"][:] = np.nan
        dimmed = inject(tpf, planet, seed=1)
        np.testing.assert_array_equal(flux_of(dimmed), expected)
        assert np.isnan(dimmed.flux_err.value).all()
        added = inject(tpf, brighter, seed=1)
        light = added.hdu["INJECTED"].data["FLUX_ADDED"]
        drawn = flux_of(added) - flux_of(tpf) - light
        seconds = crowded.detector.exposure_time
        lit = light > 1
        assert np.std(drawn[lit] / np.sqrt(light[lit] / seconds)) == pytest.approx(1, abs=0.1)
        assert not drawn[light == 0].any()


class TestFile:
    def test_table_of_the_truth(self, crowded, planet, tmp_path):
        path = crowded.write(tmp_path / "star.fits")
        injected = inject(path, planet, seed=1)
        table = injected.hdu["INJECTED"].data
        np.testing.assert_array_equal(table["SIGNAL"], planet(crowded.time))
        assert table["CADENCENO"].tolist() == crowded.cadenceno.tolist()
        own = observe([crowded.stars[0]], noise=False, keep_model=True).truth.model
        expected = own * (table["SIGNAL"] - 1)[:, np.newaxis, np.newaxis]
        np.testing.assert_allclose(table["FLUX_ADDED"], expected, rtol=1e-6, atol=1e-3)

    def test_scene_and_truth_have_the_signal(self, crowded, planet):
        target, *others = crowded.stars
        once = inject(crowded.to_tpf(quality_bitmask="none"), planet, seed=1)
        wave = 1 + 0.01 * np.sin(np.arange(N))
        twice = inject(once, wave, seed=1)
        signal = planet(crowded.time)
        for tpf, relative in ((once, signal), (twice, signal * wave)):
            expected = observe([target.replace(signal=relative), *others])
            assert read_scene(tpf) == read_scene(expected.to_tpf(quality_bitmask="none"))
            truth = read_truth(tpf)
            np.testing.assert_allclose(truth.relative_flux[0], relative, rtol=1e-12)
            np.testing.assert_allclose(truth.target_share, expected.truth.target_share)

    def test_scene_stays_with_light_of_other_kinds(self, crowded, planet):
        tpf = crowded.to_tpf(quality_bitmask="none")
        assert read_scene(inject(tpf, planet, 0.5, seed=1)) == read_scene(tpf)

    def test_is_written_and_read(self, crowded, planet, tmp_path):
        import lightkurve

        injected = inject(crowded.to_tpf(quality_bitmask="none"), planet, seed=1)
        path = write_hdulist(injected.hdu, tmp_path / "injected.fits")
        again = lightkurve.read(path, quality_bitmask="none")
        assert type(again) is type(injected)
        np.testing.assert_array_equal(again.flux.value, injected.flux.value)
        assert again.hdu[0].header["INJECTED"] == 1
        twice = inject(path, star=Star(15.0, 6.0, 6.0), seed=1)
        assert twice.hdu[0].header["INJECTED"] == 2
        assert twice.hdu["INJECTED", 2].header["KIND"] == "star"
        again.hdu.close()

    def test_signal_of_the_cadences_of_the_object(self, crowded):
        quality = np.zeros(N, dtype=np.int32)
        quality[::10] = 1 << 20
        flagged = Motion.from_arrays(crowded.time, crowded.motion.x, crowded.motion.y, quality)
        tpf = observe(Star(12.0), motion=flagged).to_tpf()
        assert len(tpf.flux) == N - 12
        relative = np.linspace(0.9, 1.1, N - 12)
        injected = inject(tpf, relative, noise=False)
        after, before = (flux_of(t).sum(axis=(1, 2)) for t in (injected, tpf))
        np.testing.assert_allclose(after / before, relative, rtol=2e-3)
        assert (injected.hdu["INJECTED"].data["SIGNAL"][::10] == 1).all()

    @pytest.mark.parametrize(
        "name",
        [
            "k2_tpf/ktwo211983544-c18_lpd-targ.fits.gz",
            "tess_tpf/tesssip_tpf1.fits",
            "kepler_tpf/kplr009002278-2010174085026_lpd-targ.fits.gz",
        ],
    )
    def test_real_pixels(self, shared_data, name):
        tpf = read_tpf(shared_data / name)
        t0 = float(np.nanmedian(tpf.time.value))
        dip = lambda time: 1 - 0.5 * (np.abs(time - t0) < 0.3)  # noqa: E731
        injected = inject(tpf, dip, 0.8, noise=False)
        assert type(injected) is type(tpf)
        inside = dip(tpf.time.value) < 1
        good = np.isfinite(tpf.flux.value)
        assert np.array_equal(np.isfinite(injected.flux.value), good)
        after, before = (np.nansum(t.flux.value, axis=(1, 2), dtype=float) for t in (injected, tpf))
        expected = np.where(inside, 0.6, 1.0) * before
        np.testing.assert_allclose(after, expected, rtol=1e-5)
        new = inject(tpf, star=Star(15.0, 1.0, 1.0), seed=1)
        added = np.nansum(new.flux.value - tpf.flux.value, axis=(1, 2))
        assert np.median(added[added != 0]) > 0.4 * Detector.from_tpf(tpf).flux_from_mag(15.0)


class TestRefused:
    @pytest.fixture
    def tpf(self):
        return observe(Star(12.0), n=20).to_tpf(quality_bitmask="none")

    @pytest.mark.parametrize(
        "signal, message",
        [
            (np.ones(7), "one number for each of the 20 cadences"),
            (-np.ones(20), "`signal` must not be negative"),
            (np.full(20, np.nan), "`signal` must be finite"),
            (lambda time: time - 1e6, "`signal` must not be negative"),
        ],
    )
    def test_signals(self, tpf, signal, message):
        with pytest.raises(ValueError, match=message):
            inject(tpf, signal)

    @pytest.mark.parametrize(
        "star, error, message",
        [
            (1.2, ValueError, "`star` must be a share between 0 and 1, got 1.2"),
            ("fit", TypeError, "`star` must be a Scene, a fit, a Star or a share, got 'fit'"),
            (Star(12.0, 20.0, 3.0), ValueError, "`star` is outside the stamp: column 20 and row 3"),
        ],
    )
    def test_stars(self, tpf, star, error, message):
        with pytest.raises(error, match=message):
            inject(tpf, np.ones(20), star)

    @pytest.mark.parametrize("noise", ["no", None, ("photon",)])
    def test_noise(self, tpf, noise):
        with pytest.raises(TypeError, match="`noise` must be True or False, got "):
            inject(tpf, np.ones(20), noise=noise)

    def test_neither(self, tpf):
        with pytest.raises(TypeError, match="`star` must be a Star if there is no `signal`"):
            inject(tpf)

    def test_whole_star_outside(self, tpf):
        with pytest.raises(ValueError, match="`star` is outside the stamp"):
            inject(tpf, star=Star(12.0, -1.0, 3.0))

    def test_no_scene(self, tpf):
        del tpf.hdu["SCENE"]
        with pytest.raises(ValueError, match="`star` must be given: the file holds no scene"):
            inject(tpf, np.ones(20))

    def test_light_curve(self, tpf):
        with pytest.raises(TypeError, match=r"`tpf` must be .* path of one, got KeplerLightCurve"):
            inject(tpf.to_lightcurve(), np.ones(20))

    def test_another_shape(self, tpf):
        scene = observe(Star(12.0), n=20, detector=Detector.k2(shape=(5, 5))).scene
        with pytest.raises(ValueError, match=r"has \(5, 5\) pixels, the file \(11, 11\)"):
            inject(tpf, np.ones(20), scene)

    def test_signals_with_units(self, tpf):
        same = inject(tpf, np.full(20, 0.9) * u.dimensionless_unscaled, noise=False)
        assert flux_of(same).sum() == pytest.approx(0.9 * flux_of(tpf).sum(), rel=0.01)


def test_star_in_a_file_without_positions():
    tpf = simulate(Star(12.0), Detector.k2(), Motion.still(30), seed=1).to_tpf()
    for name in ("POS_CORR1", "POS_CORR2"):
        tpf.hdu[1].data[name][:] = np.nan
    dimmed = inject(tpf, np.full(30, 0.9), Star(12.0), noise=False)
    part = float(np.nansum(dimmed.flux) / np.nansum(tpf.flux))
    assert part == pytest.approx(0.9, abs=1e-3)


REAL = [
    *("k2_tpf/ktwo211956421-c05_lpd-targ", "k2_tpf/ktwo211983544-c18_lpd-targ"),
    "kepler_tpf/kplr009002278-2010174085026_lpd-targ",
    *(f"kepler_q12_ch4/tpf_0{n}" for n in (1, 2, 4, 5, 6, 7, 8)),
]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::scope_models.exceptions.ScopeModelsWarning")
@pytest.mark.parametrize(
    "name", [*(f"{name}.fits.gz" for name in REAL), "tess_tpf/tesssip_tpf1.fits"]
)
def test_default_injection_into_a_real_file(shared_data, tmp_path, name):
    path, output = shared_data / name, tmp_path / "planet.fits"
    before = read_tpf(path, quality_bitmask="none")
    series = read_pixels(path)
    period = np.ptp(series.time)
    row = inject_file(path, {"period": period, "depth": 0.02, "duration": period / 20}, output)
    after = read_tpf(output, quality_bitmask="none")
    added = after.hdu["INJECTED"].data["FLUX_ADDED"]
    signal = after.hdu["INJECTED"].data["SIGNAL"]
    assert signal.min() == pytest.approx(0.98, abs=0.002)
    assert not added[signal == 1].any()
    seen = (signal < 0.985) & np.isin(after.hdu["INJECTED"].data["CADENCENO"], series.cadenceno)
    assert seen.sum() >= 3
    assert (added[seen].sum(axis=(1, 2)) < 0).all()
    assert 0.005 < row["injected_depth"] < 0.04
    np.testing.assert_array_equal(np.isfinite(after.flux.value), np.isfinite(before.flux.value))


def test_scene_of_many_stars_is_simulated_twice_with_a_bar(monkeypatch):
    """Before and after the change; the truth of the file is that of the second simulation."""
    rng = np.random.default_rng(2)
    stars = [Star(12.0, 5, 5), *(Star(19.0, *rng.uniform(0, 10, 2)) for _ in range(99))]
    tpf = observe(stars, n=20).to_tpf(quality_bitmask="none")

    class Terminal(io.StringIO):
        def isatty(self):
            return True

    monkeypatch.setattr(sys, "stderr", Terminal())
    monkeypatch.setattr(_light, "_PATIENCE", 0.0)
    monkeypatch.setattr(module, "simulate", Mock(side_effect=simulate))
    signal = np.linspace(1, 0.9, 20)
    injected = inject(tpf, signal, seed=1)
    assert module.simulate.call_count == 2
    assert "simulate: " in sys.stderr.getvalue()
    assert "/100 [" in sys.stderr.getvalue()
    np.testing.assert_allclose(read_truth(injected).relative_flux[0], signal)
