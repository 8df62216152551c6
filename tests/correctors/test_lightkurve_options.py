"""Scripts that were written for lightkurve's PLDCorrector: accepted, or refused by name."""

import numpy as np
import pytest
from astropy.table import Table
from lightkurve.correctors import DesignMatrix
from lightkurve.correctors.cbvcorrector import KeplerCotrendingBasisVectors

from scope_models.benchmark import make_sky
from scope_models.correctors import PLDCorrector, PLDOptions
from scope_models.exceptions import DetrendingWarning
from scope_models.photometry import cdpp


@pytest.fixture(scope="module")
def corrector(star):
    return PLDCorrector(star.tpf)


@pytest.mark.parametrize("name", ["pipeline", "threshold", "all"])
def test_named_apertures_are_those_of_lightkurve(name):
    tpf = make_sky("k2-1x-constant", seed=0, n_cadences=100).to_tpf()
    expected = tpf._parse_aperture_mask(name)
    np.testing.assert_array_equal(PLDCorrector(tpf, name).aperture_mask, expected)


def test_a_file_without_an_aperture(star):
    with pytest.raises(ValueError, match='`aperture_mask` cannot be "pipeline": the file has no'):
        PLDCorrector(star.tpf, "pipeline")


def test_unknown_name_of_an_aperture(star):
    with pytest.raises(ValueError, match='`aperture_mask` must be a mask, None, "pipeline"'):
        PLDCorrector(star.tpf, "best")


def test_renamed_options_act(corrector):
    flux = corrector.correct(order=3, options=PLDOptions(max_clips=0), propagate_errors=True).flux
    np.testing.assert_array_equal(corrector.correct(pld_order=3, niters=0).flux, flux)
    assert "order 3" in corrector.result.groups


def test_pca_components_limit_each_order(corrector):
    corrector.correct(pca_components=4)
    assert max(corrector.result.n_columns[:3]) == 4
    corrector.correct(pca_components=0)
    assert max(corrector.result.n_columns[:3]) > 4


def test_pld_aperture_mask_chooses_the_regressors(star):
    corrector = PLDCorrector(star.tpf, "all")
    small = np.zeros((9, 9), dtype=bool)
    small[3:6, 3:6] = True
    corrector.correct(order=1, pld_aperture_mask=small)
    assert corrector.result.n_columns[0] <= 9
    assert corrector.aperture_mask.all()
    assert cdpp(corrector.corrected_lc) < star.floor(corrector)


def test_background_aperture_mask_chooses_the_background(star):
    mask = np.zeros((9, 9), dtype=bool)
    mask[3:6, 3:6] = True
    corrector = PLDCorrector(star.tpf, mask)
    corrector.correct(order=1, background_aperture_mask="background")
    assert corrector.result.n_columns[corrector.result.groups.index("background")] == 3
    corrector.correct(order=1, options=PLDOptions(background_aperture_mask=~mask, background=2))
    assert corrector.result.n_columns[corrector.result.groups.index("background")] == 2


@pytest.mark.parametrize(
    ("option", "match"),
    [
        ({"spline_n_knots": 20}, '`spline_n_knots` is not an option here: .* `trend="gp"`'),
        ({"spline_degree": 3}, '`spline_degree` .* `trend="quadratic"`'),
        ({"sparse": True}, "`sparse` is not an option here: .*leave it out"),
        ({"normalize_background_pixels": True}, "`normalize_background_pixels`.*`regressors`"),
        ({"propagate_errors": False}, "`propagate_errors` cannot be False"),
        ({"n_samples": 5}, "`n_samples` is not an option here: errors are computed"),
        ({"use_gp": True}, "`use_gp` is not an option"),
    ],
)
def test_options_without_counterpart_name_the_successor(corrector, option, match):
    with pytest.raises(ValueError, match=match):
        corrector.correct(**option)


def test_misspelled_option(corrector):
    with pytest.raises(TypeError, match="unexpected keyword argument 'ordr'"):
        corrector.correct(ordr=2)


def test_design_matrix(corrector):
    collection = corrector.create_design_matrix(order=2)
    assert [m.name for m in collection.matrices] == list(corrector.result.groups)
    assert collection.values.shape == (400, sum(corrector.result.n_columns))
    sigma = [m.prior_sigma[0] ** 2 for m in collection.matrices]
    np.testing.assert_allclose(sigma, corrector.result.prior_variance)
    collection = corrector.create_design_matrix(order=1)
    assert collection.matrices[0].values.shape[1] == corrector.result.n_columns[0]
    assert [m.name for m in collection.matrices] == ["order 1", "focus", "aperture", "misfit"]


def drifting(star, corrector, drift):
    """Return the same star in a telescope whose throughput drifts."""
    hdus = star.tpf.hdu.__class__([hdu.copy() for hdu in star.tpf.hdu])
    hdus[1].data["FLUX"][:] = star.tpf.flux.value * (1 + 0.01 * drift)[:, None, None]
    tpf = type(star.tpf)(hdus)
    return PLDCorrector(tpf, corrector.aperture_mask)


@pytest.fixture(scope="module")
def drift():
    """Return a slow walk of mean 0."""
    return np.convolve(np.random.default_rng(3).normal(size=420), np.ones(21) / 5, "valid")


@pytest.fixture(scope="module")
def drifted(star, corrector, drift):
    """Return a corrector of the star that drifts, and its flux by a default call."""
    target = drifting(star, corrector, drift)
    with pytest.warns(DetrendingWarning, match="the noise has .* times the variance of FLUX_ERR"):
        return target, target.correct().flux.value


@pytest.mark.parametrize("kind", ["array", "matrix", "vectors", "list"])
def test_regressors_of_the_user(star, drift, drifted, kind):
    """A change of throughput leaves no trace in the fractions; a column of it removes it."""
    columns = np.stack([drift, np.random.default_rng(4).normal(size=400)], axis=1)
    vectors = KeplerCotrendingBasisVectors(
        Table(
            {"CADENCENO": np.arange(1, 401), "VECTOR_1": columns[:, 0], "VECTOR_2": columns[:, 1]}
        ),
        time=star.tpf.time,
    )
    regressors = {
        "array": columns,
        "matrix": DesignMatrix(columns, name="cbv"),
        "vectors": vectors,
        "list": [columns[:, 0], DesignMatrix(columns[:, 1:])],
    }[kind]
    target, plain = drifted
    clean = target.correct(regressors=regressors).flux.value
    assert "regressors" in target.result.groups
    assert np.std(clean) / np.mean(clean) < 0.02 * np.std(plain) / np.mean(plain)  # 0.008


def test_regressors_need_a_row_per_cadence(corrector):
    with pytest.raises(ValueError, match="`regressors` must have 400 rows, got shape"):
        corrector.correct(regressors=np.ones((5, 2)))


def test_defaults_of_lightkurve_are_accepted(corrector, corrected):
    names = ("pld_order", "spline_n_knots", "normalize_background_pixels", "use_gp", "niters")
    again = corrector.correct(sparse=False, **dict.fromkeys(names)).flux
    np.testing.assert_array_equal(again, corrected.corrected_lc.flux)


def test_masks_of_integers(star):
    bits = np.ones((9, 9), dtype=np.int32)
    bits[3:6, 3:6] |= 2
    corrector = PLDCorrector(star.tpf, bits)
    np.testing.assert_array_equal(corrector.aperture_mask, bits == 3)
    corrector = PLDCorrector(star.tpf, bits // 2)
    np.testing.assert_array_equal(corrector.aperture_mask, bits == 3)
    threshold = PLDCorrector(star.tpf, "threshold").aperture_mask
    np.testing.assert_array_equal(PLDCorrector(star.tpf, "default").aperture_mask, threshold)


@pytest.mark.parametrize("name", ["dmc", "coefficients", "diagnose_priors", "model_lc", "lc"])
def test_attributes_of_lightkurve_name_the_successor(corrector, name):
    with pytest.raises(AttributeError, match=f"`{name}` is not an attribute here: .*`"):
        getattr(corrector, name)
    with pytest.raises(AttributeError, match="'PLDCorrector' object has no attribute 'dmx'"):
        _ = corrector.dmx


def test_one_neighbor_without_a_list(star):
    corrector = PLDCorrector(star.tpf)
    flux = corrector.correct(order=1, regressors=star.tpf).flux
    np.testing.assert_array_equal(corrector.correct(order=1, regressors=[star.tpf]).flux, flux)


def test_the_aperture_cannot_be_edited(star):
    corrector = PLDCorrector(star.tpf, "threshold")
    np.testing.assert_array_equal(corrector.aperture_mask, star.tpf.create_threshold_mask())
    with pytest.raises(ValueError, match="read-only"):
        corrector.aperture_mask[:] = True
    with pytest.raises(AttributeError, match="aperture_mask"):
        corrector.aperture_mask = np.ones((9, 9), dtype=bool)
