"""Section [spectra]: maps of parts of the data, their cross-spectra and null tests."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from surveysim.scene.analysis import Score
from surveysim.scene.fields import whole
from surveysim.scene.scan_section import ScanSection
from surveysim.scene.section import Section

NIGHT, DIRECTION, ARRAY = "night", "direction", "array"
FEWEST_OBSERVATIONS = 2  # of a part: random signs of fewer tell nothing of its noise


class Spectra(Section):
    """Band powers of the simulated sky from cross-spectra of split maps, and null tests of the splits.

    Needs a section [score], whose patch, taper and range of multipoles it shares.
    """

    splits: Annotated[tuple[Literal["night", "direction", "array"], ...], Field(min_length=1)]
    """Splits of the data into maps: "night" has parts of whole nights, "direction" the two senses of the scans of a
    raster or azimuth scan, "array" the two halves of the array. The first gives the reported band powers; all have null
    tests."""
    parts: Annotated[int, *whole(2, 64)] | None = None
    """Required by "night": number of parts. Nights are dealt out in turn; without [schedule], observations are."""
    ell_bin: Annotated[int, *whole(1, 1_000_000)]
    """Width of the multipole bins."""
    realizations: Annotated[int, *whole(2, 1000)]
    """Number of noise realizations: split maps with random signs of the observations."""

    @model_validator(mode="after")
    def _splits_and_parts(self) -> Self:
        if repeated := [name for name in self.splits if self.splits.count(name) > 1]:
            raise ValueError(f"splits: found {repeated[0]!r} more than once; different splits are expected")
        if (NIGHT in self.splits) != (self.parts is not None):
            found = (
                "missing; 'night' needs it" if self.parts is None else "found without the split 'night', which has it"
            )
            raise ValueError(f"parts: {found}")
        return self

    def check(self, score: Score | None, scan: ScanSection, maker: str) -> None:
        """Raise ValueError for split maps without a scored patch or by other map-makers, and scans without senses."""
        if score is None:
            raise ValueError("spectra: found without [score], whose patch and multipoles it takes")
        if maker != "binned":
            raise ValueError(f"spectra: found with map.maker = {maker!r}; 'binned' is expected for split maps")
        if score.ell_max < score.ell_min + self.ell_bin:
            most = score.ell_max - score.ell_min
            raise ValueError(
                f"spectra.ell_bin: found {self.ell_bin}; {most} or less, score.ell_max - ell_min, is expected"
            )
        if DIRECTION in self.splits and not (scan.there_and_back and scan.scans > 1):
            found = (
                f"one scan of the pattern {scan.pattern!r}" if scan.there_and_back else f"the pattern {scan.pattern!r}"
            )
            raise ValueError(
                f"spectra.splits: found {DIRECTION!r} with {found}; scans there and back, of a raster or azimuth scan,"
                " are expected"
            )
