"""Files of band powers and null tests of a run."""

from importlib.util import find_spec
from pathlib import Path

from mapmaker.spectrum_files import write_band_powers, write_null_tests, write_sacc
from surveysim.output.expected_files import SPECTRA
from surveysim.survey.split_spectra import SurveySpectra


def write_spectra(directory: Path, spectra: SurveySpectra) -> list[Path]:
    """Write the reported band powers, for `sacc` too where it is installed, and all null tests; return the paths."""
    item, nulls = spectra.reported, directory / "tables" / "nulls.ecsv"
    table, windows, sacc = (directory / name for name in SPECTRA)
    write_band_powers(table, item.powers, monte_carlo=item.monte_carlo)
    write_null_tests(nulls, item.powers, {name: split.null for name, split in spectra.splits.items()})
    if find_spec("sacc") is None:
        return [table, windows, nulls]
    write_sacc(sacc, item.powers, monte_carlo=item.monte_carlo)
    return [table, windows, nulls, sacc]
