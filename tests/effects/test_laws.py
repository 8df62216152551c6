"""Each effect follows its law in written files: the laws of studies/laws.py."""

import pytest
from laws import LAWS, TEXTS

# More than half a second of a core.
SLOW = {"cosmic_rays", "jitter_motion", "photon_transfer", "rejection", "scintillation"}


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] * (name in SLOW)) for name in LAWS]
)
def test_law_holds(name, tmp_path):
    law = LAWS[name](tmp_path)
    assert law.x.size >= 5
    assert law.deviation.max() < 1
    # The test would see a law that is wrong by 10 %, most of them one that is wrong by 1 %.
    law.predicted[:] *= 1.1
    assert law.deviation.max() > 1


def test_every_law_is_on_the_page(repository):
    page = (repository / "docs" / "evaluation_laws.rst").read_text(encoding="utf-8")
    for name, texts in TEXTS.items():
        assert name in LAWS
        assert texts["equation"] in page
        assert f"make_{name}_figure" in page
    assert len(TEXTS) == len(LAWS)
