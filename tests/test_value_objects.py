"""Objects that are what they hold: equality, hash, copies, `replace`, text, no way to edit them."""

import copy
import dataclasses
import pickle

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.modeling.models import Polynomial1D, Tabular1D
from astropy.table import Table

from scope_models import (
    BivariateGaussianPSF,
    Detector,
    Motion,
    Scene,
    Star,
    TransitModel,
    read_pixels,
    simulate,
)
from scope_models.correctors import PLDOptions
from scope_models.effects import Background, Extinction, Focus, Gaps
from scope_models.effects.base import Drawn
from scope_models.io import TPFMetadata
from scope_models.missions import MISSIONS
from scope_models.models import PRFGrid, TabulatedPRF, sinusoidal_signal, tabulated_signal
from scope_models.scene import K2Roll
from scope_models.scene.presets import PRESETS

TIME = np.arange(6.0)


def pickled(value):
    return pickle.loads(pickle.dumps(value))  # noqa: S301


def make(kind):
    """Return a new object of a kind, equal to the last one."""
    coord = SkyCoord(10.0, -5.0, unit="deg")
    detector = Detector.k2(shape=(4, 4), interpixel=np.full((4, 4), 0.9))
    scene = Scene(Star(12.0, signal=TIME + 1), detector, Motion.k2_roll(6), seed=1)
    kinds = {
        "mission": lambda: MISSIONS["K2"],
        "detector": lambda: detector,
        "motion": lambda: scene.motion,
        "star": lambda: Star(12.0, coord=coord, psf=BivariateGaussianPSF(), signal=TIME + 1),
        "scene": lambda: scene,
        "observation": lambda: simulate(scene),
        "truth": lambda: simulate(scene).truth,
        "pixels": lambda: read_pixels(simulate(scene).to_tpf()),
        "focus": lambda: Focus(0.001, events=TIME),
        "gaps": lambda: Gaps([(1.0, 2.0)]),
        "background": lambda: Background(3.0, left=np.arange(6.0)),
        "extinction": lambda: Extinction(airmass=TIME + 1),
        "options": lambda: PLDOptions(pld_aperture_mask=np.ones((4, 4), bool)),
        "metadata": lambda: TPFMetadata(mission="K2", target_id=1, extra_cards={"A": 1}),
        "preset": lambda: PRESETS["k2"],
        "roll": K2Roll,
        "statistics": scene.motion.statistics,
        "grid": lambda: PRFGrid([(1, 1), (9, 1), (1, 9)], [TabulatedPRF(np.eye(7))] * 3),
    }
    return kinds if kind is None else kinds[kind]()


def test_text_of_tables_and_mappings_is_short():
    drawn = Drawn({"FOCUS": TIME}, tables={"HITS": Table({"ROW": [1, 2]})})
    assert repr(drawn) == (
        "Drawn(columns={'FOCUS': <array of shape (6,)>}, maps={}, "
        "tables={'HITS': <table of 2 rows>})"
    )


@pytest.mark.parametrize("kind", make(None))
def test_value_objects(kind):
    one, two = make(kind), make(kind)
    for other in (
        two,
        one.replace(),
        copy.copy(one),
        copy.deepcopy(one),
        pickled(one),
    ):
        assert one == other
        assert hash(one) == hash(other)
        for item in dataclasses.fields(other):
            value = getattr(other, item.name)
            assert not (isinstance(value, np.ndarray) and value.ndim and value.flags.writeable), (
                item.name
            )
    assert one != "something else"
    assert len(repr(one).splitlines()) == 1
    name = dataclasses.fields(one)[0].name
    with pytest.raises(dataclasses.FrozenInstanceError):
        setattr(one, name, None)
    with pytest.raises(TypeError, match="unexpected keyword argument 'hue'"):
        one.replace(hue=1)


@pytest.mark.parametrize("kind, name", [("pixels", "time"), ("observation", "flux")])
def test_arrays_of_replace_cannot_be_written_to(kind, name):
    one = make(kind)
    given = np.array(getattr(one, name)) + 1
    view = given[:]
    other = one.replace(**{name: view})
    before = hash(other)
    given[0] = -5
    assert hash(other) == before
    assert not np.any(getattr(other, name) == -5)


def test_text_of_pixels_without_a_time():
    series = make("pixels")
    assert "no times" in repr(series.replace(time=np.full(6, np.nan)))
    assert "no times" in repr(series[:0])


def test_arrays_of_the_caller_stay_his_own():
    left = np.ones(3)
    background = Background(1.0, left=left)
    left[0] = 9
    assert background.left[0] == 1


@pytest.mark.parametrize(
    "one, other",
    [
        (TransitModel(), TransitModel(exposure_time=0.02)),
        (tabulated_signal(TIME, TIME + 1), tabulated_signal(TIME, TIME + 2)),
        (Tabular1D(TIME, TIME), Tabular1D(TIME, TIME + 1)),
        (TransitModel(period=2), TransitModel(period=2 * u.hour)),
        (Polynomial1D(1, c0=1), Polynomial1D(2, c0=1)),
        (sinusoidal_signal(0.1, 1.0), sinusoidal_signal(0.1, 1.0, 0.2)),
        (1.0 + 0 * TIME, 1.0 + 0 * TIME[1:]),
    ],
    ids=lambda signal: type(signal).__name__,
)
def test_stars_differ_by_all_of_their_signal(one, other):
    assert Star(12.0, signal=one) != Star(12.0, signal=other)
    for same in (copy.deepcopy(one), pickled(one)):
        assert Star(12.0, signal=one) == Star(12.0, signal=same)
        assert hash(Star(12.0, signal=one)) == hash(Star(12.0, signal=same))
