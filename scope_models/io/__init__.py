"""Reading columns of archive files, writing target pixel files with truth."""

from scope_models._moved import renamed
from scope_models.io.tpf import (
    TPFMetadata,
    make_tpf_hdulist,
    read_truth,
    write_hdulist,
    write_tpf,
)
from scope_models.io.truth import Truth

__all__ = [
    "TPFMetadata",
    "Truth",
    "make_tpf_hdulist",
    "read_truth",
    "write_hdulist",
    "write_tpf",
]

__getattr__ = renamed(__name__, TPFTruth="Truth")
