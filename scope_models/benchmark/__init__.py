"""The messy sky: stars whose truth is known, and scores of anybody's corrections of them."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "files": [
            "SkyScore", "benchmark_star", "make_benchmark", "score", "score_light_curves",
            "summarize_scores",
        ],
        "regimes": ["REGIMES", "SkyRegime"],
        "sky": ["MessyStar", "make_sky"],
    },
)  # fmt: skip
