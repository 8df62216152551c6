"""Many stars and many files: on one machine or many, kept as they are finished, and resumed."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "detrend": ["detrend_files"],
        "files": ["find_files", "fit_files", "inject_file", "inject_files", "simulate_table"],
        "results": ["read_results", "write_report"],
        "sweep": ["SweepError", "SweepResult", "run_sweep", "star_rng", "star_seed"],
    },
)
