"""Each effect follows its law in written files: the laws of studies/laws.py."""

import numpy as np
import pytest
from laws import LAWS, TEXTS


def deviation(name, table):
    """Return differences over what may be, 4 errors and a tolerance; below 1 the law holds."""
    tolerance = TEXTS[name].get("tolerance", 1e-4) * np.abs(table["predicted"]).max()
    return np.abs(table["measured"] - table["predicted"]) / (4 * table["error"] + tolerance)


@pytest.mark.parametrize("name", LAWS)
def test_law_holds(name, tmp_path):
    law = LAWS[name](tmp_path)
    assert len(law) >= 5
    assert deviation(name, law).max() < 1
    # The test would see a law that is wrong by 10 %, most of them one that is wrong by 1 %.
    law["predicted"] *= 1.1
    assert deviation(name, law).max() > 1


def test_every_law_is_on_the_page(repository):
    page = (repository / "docs" / "evaluation_laws.rst").read_text(encoding="utf-8")
    for name, texts in TEXTS.items():
        assert name in LAWS
        assert texts["equation"] in page
        assert f"make_{name}_figure" in page
        assert f"{texts['source']}\n\nRatio of " in page
    assert len(TEXTS) == len(LAWS)
