"""Compare correctors on the messy test sky: medians per regime and the worst star.

    python studies/paper/skies.py --methods raw lightkurve pld --regimes k2-1x kepler --seeds 0 1

Regimes are chosen by the beginnings of their names. lightkurve's PLDCorrector gets the best of its
orders 1 to 3 and of two apertures (the file's and the whole stamp), chosen by the truth for each
score alone: no user could do better. Scores are in floors; see `scope_models.benchmark`.
"""

from dataclasses import asdict, dataclass

import numpy as np
from _correctors import LIGHTKURVE_CORRECTORS, correct, quiet
from _study import cells, grid, percentiles, run
from astropy.table import Table

from scope_models._arrays import values_of
from scope_models.benchmark import REGIMES, make_sky, score

NAME = "skies"
SCORES = ("full", "high_passed", "amplitude", "depth", "pull", "kept")


@dataclass(frozen=True, kw_only=True)
class Skies:
    """The parameters."""

    methods: tuple[str, ...] = ("raw", "pld")  # of `METHODS`
    regimes: tuple[str, ...] = ("",)  # beginnings of names
    seeds: tuple[int, ...] = (0, 1)
    cadences: int = 1100


def raw(tpf, sky):
    """Return the scores of the pipeline's aperture."""
    return asdict(score(tpf.to_lightcurve(aperture_mask="pipeline"), sky))


def pld(tpf, sky):
    """Return the scores of PLDCorrector."""
    from scope_models import PLDCorrector

    return asdict(score(PLDCorrector(tpf).correct(), sky))


def scene(tpf, sky):
    """Return the scores of SceneCorrector."""
    from scope_models import SceneCorrector

    return asdict(score(SceneCorrector(tpf).correct(), sky))


def chosen(tpf, sky):
    """Return the scores of the corrector that the rule chooses, and its name."""
    from scope_models.correctors import choose_corrector

    corrector = choose_corrector(tpf)
    return asdict(score(corrector.corrected_lc, sky)) | {"name": type(corrector).__name__}


def lightkurve(tpf, sky):
    """Return the best scores of lightkurve's PLDCorrector."""
    lc = tpf.to_lightcurve(aperture_mask="pipeline")
    found = []
    for setting in LIGHTKURVE_CORRECTORS["lightkurve_pld"]:
        flux = correct("lightkurve_pld", setting, tpf, np.ones(sky.regime.shape, bool))
        if flux is not None:
            lc.flux = flux * lc.flux.unit
            found.append(asdict(score(lc, sky)))
    if not found:
        raise ValueError("lightkurve failed in all settings")
    best = min(found, key=lambda one: one["full"])
    return best | {"high_passed": min(one["high_passed"] for one in found)}


METHODS = {"raw": raw, "lightkurve": lightkurve, "pld": pld, "scene": scene, "chosen": chosen}


def tasks(study):
    """Return one task per star."""
    names = [name for name in REGIMES if name.startswith(study.regimes)]
    return grid("{regime}-{seed}", regime=names, seed=study.seeds)


def measure(study, task):
    """Return the scores of one star by all methods; those of a method that fails are infinite."""
    sky = make_sky(task["regime"], task["seed"], n_cadences=study.cadences)
    row = {}
    for method in study.methods:
        with quiet():
            try:
                found = METHODS[method](sky.to_tpf(), sky)
            except (ValueError, np.linalg.LinAlgError) as error:
                found = {"full": np.inf, "high_passed": np.inf, "error": str(error)}
        row |= {f"{method}_{name}": value for name, value in found.items()}
    return row


def summarize(study, table):
    """Return medians per regime and method, and the worst star.

    In ``meta``, "worse" has in how many stars each method is above 1.1 times raw.
    """
    rows = []
    for cell, part in cells(table, ("regime",)):
        for method in study.methods:
            full = values_of(part, f"{method}_full")
            rows.append(cell | {"method": method, "stars": len(part)})
            for name in SCORES:
                rows[-1][name] = percentiles(values_of(part, f"{method}_{name}"))[1]
            worst = int(np.argmax(full))
            rows[-1] |= {"worst": float(full[worst]), "worst_seed": int(part["seed"][worst])}
    summary = Table(rows)
    if "raw" in study.methods:
        limit = 1.1 * values_of(table, "raw_full")
        summary.meta["worse"] = {
            method: f"{np.sum(values_of(table, f'{method}_full') > limit)} of {len(table)} stars"
            for method in study.methods
        }
    return summary


def main(argv=None):
    """Run the study and print its summary."""
    result = run(NAME, Skies, tasks, measure, summarize, lambda *_: None, {}, argv)
    for name in (*SCORES, "worst"):
        result.summary[name].info.format = ".3f"
    print("\n".join(result.summary.pformat(max_lines=-1, max_width=-1)))
    for method, text in result.summary.meta.get("worse", {}).items():
        print(f"{method}: above 1.1 raw in {text}")
    return result


if __name__ == "__main__":
    main()
