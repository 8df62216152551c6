"""Headers with their data as they are in a FITS file."""

import io

import numpy as np
import pytest
from astropy.io import fits

from scope_models.io._headers import Block, card_texts, write_blocks

VALUES = [
    *(True, False, 0, -7, 2**63, 2**80, 0.0, -0.0, 1.0, 1e22, -1.25e-300, 1 / 3, -1e-5 / 3),
    *(-3.98 / 3600, 1e21 / 3, -1e-300 / 3, 123456789012345680.0, 10**20),
    *(np.float64(0.1), np.float32(0.1), np.int32(3), "", "K2", "eightchr", "e-/s"),
    *("nineteen letters it", "it's", "'", "x" * 45, "x" * 100, None),
]  # fmt: skip


@pytest.mark.parametrize("comment", ["", "a comment"])
@pytest.mark.parametrize("value", VALUES, ids=repr)
def test_cards_are_astropys(value, comment):
    texts = card_texts([("NAXIS1", 5, ""), ("SOME-KEY", value, comment)])
    expected = fits.Header([("NAXIS1", 5), ("SOME-KEY", value, comment)])
    assert "".join(texts) == expected.tostring(endcard=False, padding=False)


@pytest.mark.parametrize("value", [np.nan, np.inf, "\n", "é"])
def test_what_no_card_can_hold_is_refused(value):
    with pytest.raises(ValueError, match=r"Floating point|printable|newline|ASCII"):
        card_texts([("KEY", value, "")])


@pytest.mark.parametrize("seed", range(4))
def test_checksums_are_those_of_astropy(seed):
    rng = np.random.default_rng(seed)
    image = rng.normal(size=(3, 5 + seed))
    rows = np.zeros(9, dtype=[("A", ">i4"), ("B", "S3"), ("C", ">f4", (2, 3))])
    rows["C"] = rng.normal(size=(9, 2, 3))
    cards = [("TTYPE1", "A", ""), ("TFORM1", "J", ""), ("TTYPE2", "B", ""), ("TFORM2", "3A", "")]
    cards += [("TTYPE3", "C", ""), ("TFORM3", "6E", ""), ("TDIM3", "(3,2)", "")]
    number = ("NEXTEND", 2, "number of extensions")
    blocks = [Block([number, ("SEED", seed, "")]), Block([], image), Block(cards, rows)]
    stream = io.BytesIO()
    write_blocks(blocks, stream)
    stream.seek(0)
    with fits.open(stream, checksum=True) as hdus:  # a wrong one is a warning, so an error
        assert all(hdu.verify_checksum() == hdu.verify_datasum() == 1 for hdu in hdus)
        hdus.verify("exception")
        np.testing.assert_array_equal(hdus[1].data, image)
        np.testing.assert_array_equal(hdus[2].data["C"], rows["C"])
