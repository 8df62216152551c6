"""The missions' facts against archive files, lightkurve and each other."""

import pickle
from pathlib import Path

import astropy.units as u
import pytest
from astropy.io import fits

from scope_models import Mission, io
from scope_models.missions import MISSIONS, TIME_ZEROS

LAYOUTS = Path(io.__file__).with_name("layouts.hdr")
FILES = {
    "Kepler": "kepler_tpf/kplr009002278-2010174085026_lpd-targ.fits.gz",
    "K2": "k2_tpf/ktwo211983544-c18_lpd-targ.fits.gz",
    "TESS": "tess_tpf/tesssip_tpf1.fits",
}


@pytest.mark.parametrize("name", FILES)
def test_facts_are_those_of_an_archive_file(shared_data, name):
    with fits.open(shared_data / FILES[name]) as hdus:
        cards = {**hdus[0].header, **hdus[1].header}
    mission = Mission.from_header(cards)
    assert mission is MISSIONS[name]
    assert mission.telescope == cards["TELESCOP"]
    assert mission.time_zero == cards["BJDREFI"] + cards["BJDREFF"]
    assert mission.time_unit == cards["TUNIT1"]
    assert mission.int_time == pytest.approx(cards["INT_TIME"], rel=1e-12)
    assert mission.read_time == pytest.approx(cards["READTIME"], rel=1e-12)
    cadence = mission.cadence()
    assert cadence.n_frames == cards["NUM_FRM"]
    assert round(cadence.n_frames * cadence.live_fraction) == cards["NREADOUT"]
    assert mission.cadence_days() == pytest.approx(cards["TIMEDEL"], rel=1e-8)
    assert cadence.fixed_offset == cards.get("LCFXDOFF", cards.get("FXDOFF"))
    named = ("id_keyword", "magnitude_keyword", "gain_keyword", "read_noise_keyword")
    for keyword in (*(getattr(mission, field) for field in named), mission.run, *mission.places):
        assert keyword.upper() in cards


def test_quality_bits_are_lightkurves():
    from lightkurve.utils import KeplerQualityFlags, TessQualityFlags

    for name, flags in (("K2", KeplerQualityFlags), ("TESS", TessQualityFlags)):
        bits = MISSIONS[name].quality
        assert bits.rejected == flags.DEFAULT_BITMASK
        for meaning, text in (
            ("safe_mode", "Safe mode"),
            ("desaturation", "Desaturation event"),
            ("argabrightening", "Argabrightening"),
            ("cosmic_ray", "Cosmic ray in optimal aperture"),
            ("manual_exclude", "Manual exclude"),
            ("impulsive_outlier", "Impulsive outlier"),
            ("collateral_cosmic_ray", "Cosmic ray in collateral data"),
        ):
            assert flags.STRINGS[getattr(bits, meaning)] == text
    bits = MISSIONS["K2"].quality
    for meaning in ("thruster_firing", "possible_thruster_firing", "no_data", "no_fine_point"):
        text = meaning.replace("_", " ").capitalize()
        assert KeplerQualityFlags.STRINGS[getattr(bits, meaning)] == text


@pytest.mark.parametrize(
    "cards, name",
    [
        ({"MISSION": "K2", "TELESCOP": "Kepler"}, "K2"),
        ({"MISSION": "Kepler", "TELESCOP": "Kepler"}, "Kepler"),
        ({"MISSION": " tess "}, "TESS"),
        ({"TELESCOP": "Kepler", "CAMPAIGN": 0}, "K2"),
        ({"TELESCOP": "Kepler", "QUARTER": 5, "CAMPAIGN": None}, "Kepler"),
        ({"MISSION": None, "TELESCOP": "TESS"}, "TESS"),
        ({"MISSION": "other", "TELESCOP": "TESS"}, "TESS"),
        ({"TELESCOP": "HST"}, None),
        ({}, None),
    ],
)
def test_mission_of_headers(cards, name):
    found = Mission.from_header(cards)
    assert (found and found.name) == name


def test_cadences_by_name_and_length():
    kepler, tess = MISSIONS["Kepler"], MISSIONS["TESS"]
    assert kepler.cadence() is kepler.cadence("long") is kepler.cadence(30 * u.min)
    assert kepler.cadence("short") is kepler.cadence(58.85) is kepler.cadence(1 * u.min)
    assert tess.cadence("20 s") is tess.cadence(20) is tess.cadence(20 * u.s)
    assert tess.cadence_days(10 * u.min) == pytest.approx(600 / 86400)
    with pytest.raises(ValueError, match=r"one of 'long' \(1765.46 s\), .*got 30"):
        kepler.cadence(30)
    with pytest.raises(ValueError, match="`cadence` must be in s, or convert to it, got pix"):
        tess.cadence(2 * u.pix)
    with pytest.raises(TypeError, match="`cadence` must be one number"):
        tess.cadence([20, 120])


def test_a_mission_is_a_value():
    mission = MISSIONS["TESS"]
    copy = pickle.loads(pickle.dumps(mission))  # noqa: S301
    assert copy == mission
    assert hash(copy) == hash(mission)
    assert mission != MISSIONS["K2"]
    assert TIME_ZEROS == {"bkjd": 2454833.0, "btjd": 2457000.0}
    with pytest.raises(TypeError):
        MISSIONS["Roman"] = mission


def test_full_flux_is_that_of_the_shallowest_channel():
    # 0.947e6 electrons in a frame of 6.02 s
    assert MISSIONS["Kepler"].full_flux == pytest.approx(0.947e6 / 6.0198029, rel=1e-3)
    assert MISSIONS["Kepler"].frame_time == pytest.approx(6.538751429414, rel=1e-12)


@pytest.mark.parametrize("mission", MISSIONS.values(), ids=MISSIONS)
def test_every_mission_has_a_header_template(mission):
    sections = LAYOUTS.read_text(encoding="ascii").split("COMMENT ")
    sections = [s.splitlines() for s in sections if mission.template in s.partition("\n")[0]]
    keywords = [line[:8].strip() for section in sections for line in section[1:]]
    assert keywords.count("XTENSION") == 2
    for keyword in (mission.id_keyword, mission.magnitude_keyword, mission.gain_keyword):
        assert keyword in keywords
    for name in (mission.run, *mission.places):
        assert name.upper() in keywords
