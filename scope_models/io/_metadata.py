"""The headers of a target pixel file, and how the missions' layouts differ."""

import datetime as dt
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, field

import astropy.units as u

from scope_models._arrays import DIGITAL, PER_PIXEL
from scope_models._checks import check_fields, checked_matrix, integer, number
from scope_models._values import Value
from scope_models.missions import MISSIONS

__all__ = ["TPFMetadata"]

_SECONDS_PER_DAY = 86400.0
_LONG_CADENCE = 0.01  # days: between the 58.8 s and the 29.4 min of the Kepler photometer
_MODULES = (2, 3, 4, *range(6, 21), 22, 23, 24)  # those at the corners are fine-guidance sensors
# Fields that a mission, and a detector, have by the same name.
_OF_MISSION = ("pixel_scale", "int_time", "read_time")
_OF_DETECTOR = (*_OF_MISSION, "mission", "n_frames", "gain", "read_noise", "mean_black")
_OF_DETECTOR += ("fixed_offset",)
_RUNS = ("quarter", "campaign", "sector")


@dataclass(frozen=True, eq=False, kw_only=True)
class TPFMetadata(Value):
    """Facts for the headers of a target pixel file.

    `of` takes those of a detector. What is None and has no default below becomes a card without a
    value, as in archive files.

    Parameters
    ----------
    mission : {"Kepler", "K2", "TESS", "Ground"}
        The layout of the file.
    target_id : int
        KEPLERID or TICID, at least 1.
    pixel_scale : float or Quantity, optional
        Size of a pixel on the sky, arcsec; by default the mission's.
    int_time, read_time : float or Quantity, optional
        Exposure and read-out time of one frame, s; by default the mission's.
    n_frames : int, optional
        Frames per cadence; by default those of the mission's usual cadence.
    object_name : str, optional
        OBJECT; by default "SIM" and the number, for the star is not the one of a catalog.
    ra, dec : float or Quantity, optional
        Position, deg; by default the middle of a field of the mission (for TESS the north
        ecliptic pole).
    x_0, y_0 : float or Quantity, optional
        The pixel (0-based, in the stamp) that looks at ``ra`` and ``dec``; by default the middle
        of the stamp.
    orientation : float or Quantity, optional
        Position angle of the direction of growing rows, deg from north to east. At 0, rows grow
        to the north and columns to the west.
    matrix : tuple of float, optional
        PC1_1, PC1_2, PC2_1 and PC2_2 of the projection, in place of ``orientation``: what a step
        along columns and rows is to the west and to the north.
    magnitude : float or Quantity, optional
        KEPMAG or TESSMAG.
    quarter, campaign, sector : int, optional
        When it was observed; only that of the mission may be given.
    channel, module, output : int, optional
        Where on the Kepler photometer; a channel implies its module and output, and conversely.
    camera, ccd : int, optional
        Where on TESS.
    column, row : int, optional
        Detector column and row of the first pixel of the stamp.
    n_readouts : int, optional
        Frames that are summed up; by default ``n_frames``.
    time_delta : float or Quantity, optional
        Length of a cadence, days; by default that of the frames.
    gain : float or Quantity, optional
        Electrons per count.
    read_noise : float or Quantity, optional
        Standard deviation of one read, electrons.
    mean_black : int, optional
        Black level of one read, counts.
    fixed_offset : int, optional
        Number added to RAW_CNTS, counts.
    seed : int, optional
        Seed of the simulation, for the card SEED.
    date : datetime.date, optional
        Day on which the file is made; by default today, UTC.
    extra_cards : mapping, optional
        Further cards: keyword to value, or to value and comment. Keywords that the layout has
        without a value (TEFF, CROWDSAP, TTABLEID, ...) are filled where they are, others are
        added to the primary header.

    Raises
    ------
    TypeError
        If a field is of the wrong kind.
    ValueError
        If a field is outside its domain, or belongs to another mission.

    Examples
    --------
    >>> from scope_models.io import TPFMetadata
    >>> metadata = TPFMetadata(mission="K2", target_id=7, channel=48)
    >>> metadata.name, metadata.module_and_output, round(metadata.cadence_days, 4)
    ('SIM 7', (14, 4), 0.0204)
    """

    mission: str
    target_id: int = integer(MISSING, 1)
    pixel_scale: float | None = number(None, u.arcsec, positive=True, equivalencies=PER_PIXEL)
    int_time: float | None = number(None, u.s, positive=True)
    read_time: float | None = number(None, u.s)
    n_frames: int | None = integer(None, 1)
    object_name: str | None = None
    ra: float | None = number(None, u.deg, any_sign=True)
    dec: float | None = number(None, u.deg, any_sign=True)
    x_0: float | None = number(None, u.pix, any_sign=True)
    y_0: float | None = number(None, u.pix, any_sign=True)
    orientation: float = number(0.0, u.deg, any_sign=True)
    matrix: tuple[float, float, float, float] | None = None
    magnitude: float | None = number(None, u.mag, any_sign=True)
    quarter: int | None = integer(None, 0)
    campaign: int | None = integer(None, 0)
    sector: int | None = integer(None, 1)
    channel: int | None = integer(None, 1, 4 * len(_MODULES))
    module: int | None = integer(None, 1)
    output: int | None = integer(None, 1, 4)
    camera: int | None = integer(None, 1, 4)
    ccd: int | None = integer(None, 1, 4)
    column: int = integer(500, 0)
    row: int = integer(500, 0)
    n_readouts: int | None = integer(None, 1)
    time_delta: float | None = number(None, u.day, positive=True)
    gain: float | None = number(None, u.electron / u.adu, positive=True, equivalencies=DIGITAL)
    read_noise: float | None = number(None, u.electron)
    mean_black: int | None = integer(None, 0)
    fixed_offset: int | None = integer(None, 0)
    seed: int | None = integer(None, 0)
    date: dt.date | None = None
    extra_cards: Mapping = field(default_factory=dict)

    def __post_init__(self):
        names = {name.lower(): name for name in MISSIONS}
        object.__setattr__(self, "mission", names.get(str(self.mission).lower(), self.mission))
        if self.mission not in MISSIONS:
            known = ", ".join(map(repr, MISSIONS))
            raise ValueError(f"`mission` must be one of {known}, got {self.mission!r}")
        usual = {name: getattr(self.layout, name) for name in _OF_MISSION}
        for name, value in (usual | {"n_frames": self.layout.cadence().n_frames}).items():
            if getattr(self, name) is None:
                object.__setattr__(self, name, value)
        check_fields(self)
        if self.dec is not None and abs(self.dec) > 90:
            raise ValueError(f"`dec` must be within -90 to 90, got {self.dec}")
        if self.n_readouts is not None and self.n_readouts > self.n_frames:
            given = f"{self.n_readouts} of {self.n_frames}"
            raise ValueError(f"`n_readouts` must not exceed `n_frames`, got {given}")
        name = "" if self.object_name is None else self.object_name
        if not isinstance(name, str) or not name.isascii():
            raise TypeError(f"`object_name` must be ASCII text, got {name!r}")
        if self.date is not None and not isinstance(self.date, dt.date):
            raise TypeError(f"`date` must be a datetime.date, got {self.date!r}")
        if not isinstance(self.extra_cards, Mapping):
            raise TypeError(f"`extra_cards` must be a mapping, got {self.extra_cards!r}")
        if self.matrix is not None:
            object.__setattr__(self, "matrix", checked_matrix(self.matrix))
        self._check_place()

    def _check_place(self):
        """Check that time and place are those of the mission, and a channel is one."""
        layout = self.layout
        for name in (*_RUNS, "channel", "module", "output", "camera", "ccd"):
            given = getattr(self, name)
            if given is not None and name not in {layout.run, *layout.places}:
                raise ValueError(f"`{name}` must not be given for {self.mission}, got {given}")
        if self.module is not None and self.module not in _MODULES:
            raise ValueError(f"`module` must be one of {_MODULES}, got {self.module}")
        for name, implied in zip(("module", "output"), self.module_and_output, strict=True):
            given = getattr(self, name)
            if given is not None and given != implied:
                wanted = f"{implied} for channel {self.channel}"
                raise ValueError(f"`{name}` must be {wanted}, got {given}")

    @classmethod
    def of(cls, detector, **facts):
        """Return the facts of a detector's files.

        Parameters
        ----------
        detector : Detector
            The detector, of a mission with target pixel files.
        **facts
            Fields of `TPFMetadata`: those of the target, and any that differ from the detector's.

        Returns
        -------
        TPFMetadata
            The facts.

        Raises
        ------
        TypeError
            If a field is misspelled or of the wrong kind.
        ValueError
            If a field is outside its domain, or belongs to another mission.

        Examples
        --------
        >>> from scope_models import Detector
        >>> from scope_models.io import TPFMetadata
        >>> TPFMetadata.of(Detector.tess(), target_id=7).reads
        48
        """
        own = {name: getattr(detector, name) for name in _OF_DETECTOR}
        return cls(**(own | {"n_readouts": detector.n_reads} | facts))

    @property
    def layout(self):
        """The mission, which fixes the special features of its files."""
        return MISSIONS[self.mission]

    @property
    def name(self):
        """The name of the target."""
        return f"SIM {self.target_id}" if self.object_name is None else self.object_name

    @property
    def position(self):
        """Right ascension (0 to 360) and declination, deg."""
        default_ra, default_dec = self.layout.field_center
        ra = default_ra if self.ra is None else self.ra % 360.0
        return ra, default_dec if self.dec is None else self.dec

    @property
    def module_and_output(self):
        """Module and output of the channel, or those given."""
        if self.channel is None:
            return self.module, self.output
        return _MODULES[(self.channel - 1) // 4], (self.channel - 1) % 4 + 1

    @property
    def full_channel(self):
        """The channel, given or derived from module and output."""
        if self.channel is None and self.module is not None and self.output is not None:
            return 4 * _MODULES.index(self.module) + self.output
        return self.channel

    @property
    def frame_time(self):
        """Length of a frame, s."""
        return self.int_time + self.read_time

    @property
    def reads(self):
        """Number of frames that are summed up."""
        return self.n_frames if self.n_readouts is None else self.n_readouts

    @property
    def cadence_days(self):
        """Length of a cadence, days."""
        if self.time_delta is not None:
            return self.time_delta
        return self.n_frames * self.frame_time / _SECONDS_PER_DAY

    @property
    def is_long_cadence(self):
        """Whether this is what the Kepler photometer calls a long cadence."""
        return self.cadence_days > _LONG_CADENCE

    @property
    def duty_cycle(self):
        """Part of a cadence in which light is gathered (DEADC)."""
        return self.int_time / self.frame_time * self.reads / self.n_frames
