r"""Benchmark 2 of the paper: noise before de-trending of stars that move as in K2.

    python studies/paper/k2_motion.py --workers 4

The paper's sensitivity and the calibrated one, `Detector.k2_calibrated`, beside the noise of K2
campaign 3. EVEREST's apertures follow the PRF; here the aperture holds the pixels in which the star
alone has more than a threshold on average, :math:`T + p F` for a flux F. Stars with a pixel above
90 % of its well have a larger aperture, as EVEREST's. See Saunders, N. et al. 2019, section 3;
Luger, R. et al. 2018, AJ, 156, 99 (EVEREST 2).
"""

import numpy as np
from _figures import make_panels, plot_cdpp
from _reference import PERCENTILES, compared, noise_band, read_reference
from _stars import DETECTORS, draw_star, motion_from_name, stamp_around
from _study import cells, grid, parameters, study_of
from astropy.table import Table
from no_motion import noise_parts

from scope_models import simulate
from scope_models.batch import star_rng, star_seed
from scope_models.photometry import cdpp
from scope_models.plotting._style import styled

CONTRIBUTIONS = ("white", "losses", "intrapixel", "systematics")
UNITS = dict.fromkeys(("cdpp", "cdpp_lightkurve", *CONTRIBUTIONS), "ppm")
EDGE = 6.94  # largest distance from the boresight in degrees, 6278 px (arXiv:1512.06162)
CAMPAIGN = 3380  # cadences of campaign 3, and what is generated at most
GOLDEN = 0.6180339887498949


@parameters
class K2MotionNoise:
    seed: int = 1
    magnitudes: tuple[float, ...] = tuple(11 + 0.5 * k for k in range(9))  # Kp
    detectors: tuple[str, ...] = ("paper", "calibrated")
    stars: int = 60  # per magnitude and detector, all over the field; the same are in all bins
    cadences: int = 1000  # at a random time of the campaign, which has 3380
    shift: float = 0.5  # px from the middle of a pixel; the paper has 0.2
    threshold: float = 32.0  # T in e-/s, fitted
    part: float = 0.001  # p, fitted
    saturated_part: float = 1e-4  # part of a saturated star's flux that a pixel of its aperture has


def field_motion(number, cadences, *, place, rng):
    """Return the motion about its median of a star in the field of view, at a time of a campaign.

    `number` is the seed of the motion, `place` the part of the field, between 0 and 1, that is
    nearer to the boresight than the star, and `rng` the source of the direction and of the time.
    """
    distance, angle = round(EDGE * np.sqrt(place), 4), np.radians(round(rng.uniform(0, 360), 2))
    start = int(rng.integers(max(CAMPAIGN - cadences, 0) + 1))
    field = float(distance * np.cos(angle)), float(distance * np.sin(angle))
    motion = motion_from_name("k2_roll", CAMPAIGN, seed=number, field=field)
    motion = motion[start : start + cadences]
    x, y = motion.x - np.median(motion.x), motion.y - np.median(motion.y)
    return type(motion).from_arrays(motion.time, x, y, time_format=motion.time_format)


tasks = grid("{detector}-kp{mag:g}-{index}", detector="detectors", mag="magnitudes", index="stars")


def observe(study, task):
    """Return the pixels of a star; both detectors see the same star and motion."""
    key = f"motion0-{task['index']}"
    rng = star_rng(study.seed, key)
    shift = star_rng(study.seed, "field", "shift").uniform()
    place = (shift + task["index"] * GOLDEN) % 1.0
    number = star_seed(study.seed, key, "motion") % 2**31
    motion = field_motion(number, study.cadences, place=place, rng=rng)
    shape, x_0, y_0 = stamp_around(motion, margin=7)
    detector = DETECTORS[task["detector"]](shape=shape)
    star = draw_star(rng, task["mag"], detector, x_0=x_0, y_0=y_0, shift=study.shift)
    return simulate(star, detector, motion, seed=star_seed(study.seed, key, "pixels"))


def measure(study, task):
    """Return the noise of a star, and what contributes to it.

    CDPP in both conventions; in EVEREST's convention and without noise, that by light moving out of
    the aperture alone ("losses"), with the response within pixels ("intrapixel"), and with that
    between pixels ("systematics"); "white", the nominal noise of photons, background and reads.
    """
    observation = observe(study, task)
    detector, scene = observation.detector, observation.scene
    alike = detector.replace(interpixel=np.ones(detector.shape))
    pixels = detector.without_sensitivity(), alike, detector
    cubes = [simulate(scene.replace(detector=each), noise=False).flux for each in pixels]
    flat = cubes[0]
    saturated = bool(np.percentile(flat, 97.5, axis=0).max() > detector.full_flux)
    aperture = choose_aperture(study, observation, flat.mean(axis=0), saturated=saturated)
    flux = observation.flux[:, aperture].sum(axis=1, dtype=float)
    row = {"cdpp": cdpp(flux, method="everest"), "cdpp_lightkurve": cdpp(flux)}
    row["white"] = float(np.linalg.norm([*noise_parts(observation, aperture).values()]))
    for name, cube in zip(CONTRIBUTIONS[1:], cubes, strict=True):
        row[name] = cdpp(cube[:, aperture].sum(axis=1, dtype=float), method="everest")
    row |= {"n_pixels": int(aperture.sum()), "saturated": saturated}
    return row | {"distance": float(observation.motion.statistics().mean.value)}


def choose_aperture(study, observation, image, *, saturated=False):
    """Return the pixels of the light curve, by the mean image on pixels that respond alike."""
    flux = observation.truth.flux[0]
    threshold = study.saturated_part * flux
    if not saturated:
        threshold = study.threshold + study.part * flux
    return image > min(threshold, 0.5 * image.max())


def summarize(study, table):
    """Return our noise beside that of campaign 3, saturated stars included, as they are in ours.

    Per detector and magnitude: percentiles with errors by resampling, ratios, and medians.
    """
    reference, rows = read_reference("k2_c03_raw", "all"), []
    for cell, stars in cells(table, ("detector", "mag")):
        row = cell | {"stars": len(stars), "saturated": float(np.mean(stars["saturated"]))}
        row |= compared("noise", stars["cdpp"], reference, cell["mag"], PERCENTILES, known="k2")
        names = ("cdpp_lightkurve", *CONTRIBUTIONS, "n_pixels")
        rows.append(row | {name: float(np.median(stars[name])) for name in names})
    return Table(sorted(rows, key=lambda row: study.detectors.index(row["detector"])))


@styled
def draw(study, _, summary):
    """Draw our noise over that of campaign 3, and what contributes to it."""
    known = noise_band("k2_c03_raw", "K2 campaign 3")
    figure, (left, right) = make_panels(2, 2, (0, 5, 0, 4.6), sharex=True, sharey=True)
    series = {}
    for number, label in enumerate(study.detectors):
        values = summary[summary["detector"] == label]
        columns = (np.array(values[f"noise_{name}"]) for name in ("median", "p10", "p90"))
        shift = 0.06 * (number - (len(study.detectors) - 1) / 2)
        series[f"{label}: median, 10 % to 90 %"] = (np.array(values["mag"]) + shift, *columns)
    texts = ("photons, background, reads", "light leaving the aperture",
             "and response within pixels", "and response between pixels")  # fmt: skip
    parts = {
        text: (values["mag"], values[name]) for name, text in zip(CONTRIBUTIONS, texts, strict=True)
    }
    plot_cdpp(series, known, title="Noise before de-trending", ax=left)
    plot_cdpp(parts, known, title=f"What contributes: {label}", ax=right)
    mag = summary["mag"]
    left.set(xlim=(min(mag) - 0.3, max(mag) + 0.3), ylim=(8, 4000))
    return figure


main = study_of("k2-motion", K2MotionNoise, tasks, measure, summarize, draw, UNITS)

if __name__ == "__main__":
    main()
