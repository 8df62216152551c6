"""Real target pixel files that several studies use, by the name of their star."""

__all__ = ["FILES"]

FILES = {
    "EPIC 211956421": "k2_tpf/ktwo211956421-c05_lpd-targ.fits.gz",
    "EPIC 211983544": "k2_tpf/ktwo211983544-c18_lpd-targ.fits.gz",
    "Kepler-62": "kepler_tpf/kplr009002278-2010174085026_lpd-targ.fits.gz",
}
