"""Claims of the paper on its figure 5, as statements that can be measured."""

from dataclasses import dataclass

import numpy as np

__all__ = [
    "CLAIMS",
    "TRANSIT_CLAIM",
    "TRANSIT_DEFINITION",
    "Claim",
    "check_transits",
    "kepler_like_to",
    "paper_limit",
]

_DETECTION, _AGREEMENT, _SHARE = 7.1, 3.0, 0.9
#: The claim on transits, which is about depths and not about noise.
TRANSIT_CLAIM = "transits are retrievable at 5x"
#: What is checked of it; 7.1 is Kepler's threshold of detection.
TRANSIT_DEFINITION = (
    f"the depth is at least {_DETECTION:g} of its errors deep and within {_AGREEMENT:g} errors of "
    f"the truth in {100 * _SHARE:g} % of the stars"
)


@dataclass(frozen=True)
class Claim:
    """A limit in ppm on the median CDPP at a multiple of K2's motion, in every bin to the faintest.

    A limit of None is the median of Kepler's stars at each magnitude: "Kepler-like" is taken in the
    sense in which EVEREST's light curves are called so, to be at most that.
    """

    name: str
    scale: float
    faintest: float
    limit: float | None

    @property
    def definition(self):
        """The statement that is checked."""
        limit = "the median of Kepler's stars" if self.limit is None else f"{self.limit:g} ppm"
        return (
            f"the median CDPP (EVEREST's convention) of the stars with {self.scale:g}x motion is "
            f"at most {limit} in every bin to Kp {self.faintest:g}"
        )

    def check(self, scale, mag, cdpp, kepler):
        """Check the claim for motion, magnitude, median CDPP and Kepler's median of each cell.

        Return "verdict" ("holds", "does not hold" or, if the grid lacks its motion, its faintest
        magnitude or the noise in one of its bins, "not checked"); "cdpp_ppm", "limit_ppm" and "mag"
        of the cell that is nearest to its limit or farthest above; and "times_below", limit over
        CDPP there: below 1 if the claim does not hold.
        """
        scale, mag, cdpp, kepler = (
            np.asarray(values, dtype=float) for values in (scale, mag, cdpp, kepler)
        )
        used = (scale == self.scale) & (mag <= self.faintest)
        limit = kepler if self.limit is None else np.full(mag.shape, float(self.limit))
        ratio = np.where(used, cdpp / limit, -np.inf)
        if not np.any(used & (mag == self.faintest)) or np.isnan(ratio).any():
            return {"verdict": "not checked"}
        worst = int(np.argmax(ratio))
        return {
            "verdict": "holds" if ratio[worst] <= 1 else "does not hold",
            "mag": float(mag[worst]),
            "cdpp_ppm": float(cdpp[worst]),
            "limit_ppm": float(limit[worst]),
            "times_below": float(1 / ratio[worst]),
        }


#: The claims on noise. The text and the caption of the paper's figure 5 differ in one magnitude.
CLAIMS = (
    Claim("2x is Kepler-like to Kp 13", 2, 13, None),
    Claim("2x is below 200 ppm to Kp 15", 2, 15, 200),
    Claim("5x is below 400 ppm to Kp 15.5", 5, 15.5, 400),
    Claim("5x is below 400 ppm to Kp 14.5 (caption)", 5, 14.5, 400),
    Claim("10x is below 1000 ppm", 10, 15.5, 1000),
)


def paper_limit(scale, mag):
    """Return the lowest limit in ppm that the paper states at a motion and magnitude, or NaN."""
    limits = [
        claim.limit
        for claim in CLAIMS
        if claim.limit and claim.scale == scale and mag <= claim.faintest
    ]
    return float(min(limits, default=np.nan))


def kepler_like_to(mag, cdpp, kepler):
    """Return the faintest magnitude to which every bin is at most Kepler's median, or None."""
    faintest = None
    for where in np.argsort(mag):
        if not cdpp[where] <= kepler[where]:
            break
        faintest = float(mag[where])
    return faintest


def check_transits(depth, error, true):
    """Check whether transits are retrieved from measured depths, their errors and the true depth.

    Return "verdict"; the "share" of stars whose depth is retrieved in the sense of
    `TRANSIT_DEFINITION`; the number of "stars"; the weighted mean of measured over true depth,
    "ratio", and its error; and the standard deviation of the deviations in units of their errors,
    "pull".
    """
    depth, error = np.asarray(depth, dtype=float), np.asarray(error, dtype=float)
    known = np.isfinite(depth) & np.isfinite(error)
    if not known.any():
        return {"verdict": "not checked"}
    depth, error = depth[known], error[known]
    pull = (depth - true) / error
    retrieved = (depth >= _DETECTION * error) & (np.abs(pull) <= _AGREEMENT)
    share = float(np.mean(retrieved))
    weight = error**-2.0
    return {
        "verdict": "holds" if share >= _SHARE else "does not hold",
        "share": share,
        "stars": len(depth),
        "ratio": float(np.sum(weight * depth) / np.sum(weight) / true),
        "ratio_error": float(np.sum(weight) ** -0.5 / true),
        "pull": float(np.std(pull)),
    }
