"""No malformed file ends in anything but its values, a warning, or one line that names it."""

import os
import subprocess
import sys

import numpy as np
import pytest
from astropy.io import fits
from broken_files import LAYOUTS, Variant, no_fits, same, survey, template, variants

from scope_models import Detector, Motion, Star, simulate
from scope_models._checks import one_line
from scope_models.cli import main


def check(chosen, folder):
    wrong = [
        f"{word}: {reader}: {variant.name}: {message}"
        for variant, reader, word, message in survey(chosen, folder)
        if word in {"failed", "differs"}
    ]
    assert wrong == []


@pytest.mark.filterwarnings("ignore")  # the survey collects them
def test_a_sample(tmp_path):
    chosen = list(variants("k2"))
    # The latter is read without a warning: its values are compared.
    check([*chosen[3::41], *(v for v in chosen if v.name == "k2: zeros after it")], tmp_path)


def test_positions_are_compared_by_their_columns():
    one = {"time": np.array([2144.1, np.nan]), "quality": None, "meta": {"filename": "one.fits"}}
    assert same(one, one | {"meta": {"filename": "other.fits"}})
    assert not same(one, one | {"time": np.array([2144.1 + 1e-9, np.nan])})
    assert not same(one, one | {"quality": np.zeros(2)})


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("layout", LAYOUTS)
def test_all(layout, tmp_path):
    chosen = list(variants(layout))
    assert len(chosen) > 150
    check(chosen, tmp_path)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_no_fits_files(tmp_path):
    check(no_fits(), tmp_path)


COMMANDS = {
    "detrend": ["detrend", "IN", "--output", "out.fits", "--order", "1"],
    "fit": ["fit", "IN", "--output", "out.fits", "--components", "1"],
    "simulate": ["simulate", "--motion", "IN", "--mag", "12", "--output", "out.fits"],
    "detector": ["simulate", "--detector", "IN.toml", "--mag", "12", "--output", "out.fits"],
    "config": ["detrend", "--config", "IN", "--output", "out.fits"],
}
# One of each kind that must be refused by every command.
REFUSED = {
    "text": b"no FITS file at all\n" * 300,
    "zip": b"PK\x03\x04" + bytes(5000),
    "empty": b"",
    "gzip": b"\x1f\x8b" + bytes(range(256)) * 20,
    "cut": None,
    "claims": None,
}


@pytest.fixture(scope="module")
def refused():
    """Return the contents of files that every command refuses."""
    whole = template("k2")
    return {
        **REFUSED,
        "cut": whole[: len(whole) // 2],
        "claims": whole.replace(b"NAXIS2  =            ", b"NAXIS2  =     1099511"),
    }


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("kind", REFUSED)
@pytest.mark.parametrize("name", COMMANDS)
def test_commands_end_with_one_line(name, kind, refused, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for source in ("IN", "IN.toml"):
        (tmp_path / source).write_bytes(refused[kind])
    if name in {"detector", "config"} and kind == "empty":
        pytest.skip("an empty TOML file has no fields, which another test covers")
    assert main(COMMANDS[name]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert error.startswith("scope-models: error: ")
    assert "IN" in error
    assert sorted(path.name for path in tmp_path.iterdir()) == ["IN", "IN.toml"]


def _dropped(name):
    def change(hdus):
        header = hdus[1].header
        kept = ("TELESCOP", "MISSION", "BJDREFI", "BJDREFF", "OBJECT")
        columns = [column for column in hdus[1].columns if column.name != name]
        hdus[1] = fits.BinTableHDU.from_columns(columns)
        hdus[1].header.update({key: header[key] for key in kept if key in header})

    return change


def _column_of_first_pixel(hdus):
    hdus[1].header["1CRV5P"] = 10**30


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("command", ["detrend", "fit"])
def test_header_text_is_escaped(command, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    observation = simulate(Star(12.0), Detector.k2(shape=(7, 7)), Motion.k2_roll(60), seed=1)
    path = observation.write("star.fits")
    card = b"BJDREFI =              2454833"
    assert card in path.read_bytes()
    hostile = b"BJDREFI = '\x00\x1b[2J\n\x07'".ljust(len(card))
    path.write_bytes(path.read_bytes().replace(card, hostile))
    assert main([command, "star.fits", "--output", "out.fits"]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert lines
    assert all(line.isprintable() for line in lines)


def test_one_line():
    assert one_line("a\x00b\n c\x1b[2J \xe4") == "a\\x00b c\\x1b[2J \xe4"


def _aperture_of_bytes(hdus):
    hdus[2] = fits.ImageHDU(hdus[2].data.astype(np.uint8), name="APERTURE")


@pytest.mark.parametrize(
    "change, message",
    [
        (_dropped("FLUX_ERR"), "has no column FLUX_ERR"),
        (_dropped("CADENCENO"), "has no column CADENCENO"),
        (_column_of_first_pixel, "1CRV5P must be a detector column or row"),
        (_aperture_of_bytes, None),
    ],
    ids=["error", "number", "column", "aperture"],
)
def test_detrend_of_files_that_lack_something(change, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    observation = simulate(Star(12.0), Detector.k2(shape=(7, 7)), Motion.k2_roll(60), seed=1)
    with fits.open(observation.write("star.fits")) as hdus:
        change(hdus)
        hdus.writeto("changed.fits", checksum=True)
    status = main(["detrend", "changed.fits", "--output", "out.fits", "--order", "1"])
    assert status == (0 if message is None else 2)
    assert (message or "") in capsys.readouterr().err


def run(command, folder, content, limit=2 << 30):
    """Run a command under a limit of memory; return the status and the standard error."""
    (folder / "IN").write_bytes(content)
    code = "import sys; from scope_models.cli import main; sys.exit(main())"
    if os.name == "posix":
        code = f"import resource; resource.setrlimit(resource.RLIMIT_AS, ({limit},) * 2); {code}"
    result = subprocess.run(
        [sys.executable, "-c", code, *command, "--overwrite"],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    return result.returncode, result.stderr


@pytest.mark.slow
@pytest.mark.parametrize("name", ["detrend", "fit", "simulate"])
def test_commands_on_a_sample(name, tmp_path):
    """Status 0 or 2, no traceback, within 2 GiB and two minutes."""
    sample: list[Variant] = [*variants("k2", "tess")][7::24]
    wrong = []
    for variant in [*sample, *no_fits()]:
        status, error = run(COMMANDS[name], tmp_path, variant.content)
        lines = error.strip().splitlines()
        if status not in (0, 2) or not all(line.startswith("scope-models: ") for line in lines):
            wrong.append(f"{variant.name}: {status}: {lines[-1:]}")
    assert wrong == []
