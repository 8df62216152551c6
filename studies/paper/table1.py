"""Table 1 of the paper: how far the star moves, at multiples of K2's motion.

    python studies/paper/table1.py --scales 1 2 5 10

The distance of the star from its reference position has a mean, a standard deviation and a maximum;
the extent is the largest distance between any two positions.
"""

from _stars import motion_from_name
from _study import parameters, study_of

LENGTHS = ("mean", "std", "maximum", "extent")
UNITS = dict.fromkeys(LENGTHS, "pix") | {f"{name}_angle": "arcsec" for name in LENGTHS[:3]}


@parameters
class Table1:
    motions: tuple[str, ...] = ("k2_roll",)  # files or generators, see `motion_from_name`
    scales: tuple[float, ...] = (1.0, 2.0, 5.0, 10.0)
    cadences: int = 1000  # from the beginning of each motion
    pixel_scale: float = 3.98  # arcsec


def tasks(study):
    """Return one task per motion and scale."""
    return [
        {"key": f"motion{number}-x{scale:g}", "motion": motion, "scale": scale}
        for number, motion in enumerate(study.motions)
        for scale in study.scales
    ]


def measure(study, task):
    """Return the statistics of a motion in pixels and as angles."""
    motion = task["scale"] * motion_from_name(task["motion"], study.cadences)
    pixels = motion.statistics(study.pixel_scale)
    angles = pixels.in_arcsec()
    row = {"cadences": len(motion)} | {name: getattr(pixels, name).value for name in LENGTHS}
    return row | {f"{name}_angle": getattr(angles, name).value for name in LENGTHS[:3]}


main = study_of("table1", Table1, tasks, measure, None, None, UNITS)

if __name__ == "__main__":
    main()
