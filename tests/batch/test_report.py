"""The page about a run: it holds everything, and shows what the run has measured."""

import re
from html.parser import HTMLParser

import numpy as np
import pytest
from astropy.io import fits

from scope_models import Detector, Motion, Star, simulate
from scope_models.batch import SweepError, detrend_files, read_results, simulate_table, write_report
from scope_models.batch.results import _star
from scope_models.cli import main
from scope_models.exceptions import FailedStarsWarning

QUIET = {"progress": False}


class Page(HTMLParser):
    """The tags, the text and the cells of a page; every tag must be closed."""

    def __init__(self, text):
        super().__init__()
        self.open, self.images, self.words, self.rows = [], [], [], []
        self.feed(text)
        assert not self.open

    def handle_starttag(self, tag, attrs):
        if tag == "img":
            self.images.append(dict(attrs)["src"])
        elif tag != "meta":
            self.open.append(tag)
        if tag == "tr":
            self.rows.append([])

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.words.append(data)
        if self.open[-1] in {"td", "th"}:
            self.rows[-1].append(data)

    @property
    def text(self):
        return " ".join(self.words)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Return the folder of a run with stars of 13th magnitude, a noisy one and three failures.

    The pixels of one star were moved away.
    """
    folder = tmp_path_factory.mktemp("run")
    detector, paths = Detector.k2(shape=(9, 9)), []
    for n in range(4):
        observation = simulate(Star(13), detector, Motion.k2_roll(150, seed=n), seed=n)
        paths.append(folder / f"star{n}.fits")
        metadata = {"object_name": "<i>odd</i>" if n == 2 else f"EPIC {n}"}
        observation.write(paths[-1], metadata=metadata)
    rng = np.random.default_rng(1)
    with fits.open(paths[2], mode="update") as hdus:
        flux = hdus[1].data["FLUX"]
        flux *= rng.normal(1, 0.01, len(flux)).astype("f4")[:, None, None]
        hdus[1].add_checksum()
    for n in range(2):
        paths.append(folder / f"cut{n}.fits")
        paths[-1].write_bytes(paths[0].read_bytes()[: 20_000 + 5_000 * n])
    paths.append(folder / "empty.fits")
    fits.PrimaryHDU().writeto(paths[-1])
    with pytest.warns(FailedStarsWarning):
        detrend_files(paths, folder / "out", order=1, sweep=QUIET)
    paths[0].unlink()
    return folder / "out"


@pytest.fixture(scope="module")
def path(run):
    """Return the page of the run."""
    return write_report(run)


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    """Return the folder of a run without light curves."""
    folder = tmp_path_factory.mktemp("plain") / "out"
    simulate_table({"mag": [11.0, 12.0]}, folder, cadences=30, sweep=QUIET)
    return folder


def test_page(run, path):
    text = path.read_text(encoding="utf-8")
    page, table = Page(text), read_results(run)
    assert path == run / "report.html"
    numbers = dict(row for row in page.rows if len(row) == 2)
    assert (numbers["stars"], numbers["failed"]) == ("4", "3")
    ratio = float(np.median(table["cdpp_everest"] / table["raw_cdpp_everest"]))
    assert float(numbers["median noise over raw"]) == pytest.approx(ratio, abs=0.006)
    assert "EVEREST 2 (AJ 156, 99)" in page.text
    assert len(page.images) == 5
    assert text.index("(star2)") < text.index("(star0)")  # the noisy one is the first
    assert "Failures" in page.words


def test_needs_no_network_and_runs_nothing(path):
    text = path.read_text(encoding="utf-8")
    assert all(image.startswith("data:image/png;base64,") for image in Page(text).images)
    assert not re.search(r"https?:|<script|<link|src=\"(?!data:)", text)
    assert "<i>odd" not in text  # what files hold is text
    assert "&lt;i&gt;odd" in text
    assert '<meta name="viewport"' in text  # small screens show it at its own size
    assert "color-scheme: light dark" in text


def test_failures_by_cause(path):
    page = Page(path.read_text(encoding="utf-8"))
    after = page.text[page.text.index("Failures") :]
    assert re.search(r"2\s+\(cut0, cut1\): ", after)
    assert re.search(r"1\s+\(empty\): ", after)
    assert "Traceback" in after


@pytest.mark.parametrize("mission, expected", [("K2", "Time (BKJD)"), ("TESS", "Time (BTJD)")])
@pytest.mark.parametrize("pixels", ["there", "away"])
def test_times_are_those_of_the_mission(run, mission, expected, pixels):
    row = dict(read_results(run)[int(pixels == "there")]) | {"mission": mission}
    assert (run.parent / row["file"]).exists() == (pixels == "there")
    labels = {label for ax in _star(run, row).axes for label in (ax.get_xlabel(), ax.get_ylabel())}
    assert expected in labels
    assert "Time (d)" not in labels


def test_all_have_failed(tmp_path):
    (tmp_path / "text.fits").write_text("no FITS file")
    with pytest.warns(FailedStarsWarning), pytest.raises(SweepError):
        detrend_files([tmp_path / "text.fits"], tmp_path / "out", sweep=QUIET)
    page = Page(write_report(tmp_path / "out").read_text(encoding="utf-8"))
    assert dict(row for row in page.rows if len(row) == 2)["failed"] == "1"


def test_stars_too_short_for_a_noise(tmp_path):
    scene = Star(11), Detector.tess(), Motion.tess(60)
    path = simulate(*scene, seed=1).write(tmp_path / "short.fits")
    detrend_files([path], tmp_path / "out", order=1, sweep=QUIET)
    page = Page(write_report(tmp_path / "out").read_text(encoding="utf-8"))
    assert "nan" not in page.text.lower().split()
    assert "median noise over raw" not in page.text


def test_other_runs(plain, tmp_path):
    page = Page(write_report(plain, tmp_path / "page.html").read_text(encoding="utf-8"))
    assert dict(row for row in page.rows if len(row) == 2)["stars"] == "2"
    assert not page.images


def test_command(plain, tmp_path, capsys):
    assert main(["report", str(plain), "--output", str(tmp_path / "page.html")]) == 0
    assert capsys.readouterr().out.strip() == str(tmp_path / "page.html")
    assert (tmp_path / "page.html").read_text() == write_report(plain).read_text()
    assert main(["report", str(tmp_path)]) == 2
    assert "is not a results directory" in capsys.readouterr().err
