"""Reading columns of archive files, writing target pixel files with truth."""

from scope_models.io.tpf import (
    TPFMetadata,
    TPFTruth,
    make_tpf_hdulist,
    read_truth,
    write_hdulist,
    write_tpf,
)

__all__ = [
    "TPFMetadata",
    "TPFTruth",
    "make_tpf_hdulist",
    "read_truth",
    "write_hdulist",
    "write_tpf",
]
