"""The door in, from target pixel files to arrays, and the door out, with the truth."""

from scope_models.io._opening import conf
from scope_models.io._truth import Truth
from scope_models.io.pixels import PixelSeries, read_pixels, read_tpf, usable_positions
from scope_models.io.tpf import TPFMetadata, read_truth, write_tpf

__all__ = [
    "PixelSeries", "TPFMetadata", "Truth", "conf", "read_pixels", "read_tpf", "read_truth",
    "usable_positions", "write_tpf",
]  # fmt: skip
