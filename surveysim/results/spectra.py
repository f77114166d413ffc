"""Band powers and null tests of the splits of a run: entries of summary.json, tables, sentences, warnings."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from mapmaker.null_tests import ChiSquared
from mapmaker.uncertainty import FEWEST
from surveysim.reduction.setup import Setup
from surveysim.reduction.splits import SurveySplits
from surveysim.runtime.numbers import count, joined, number, short
from surveysim.runtime.strict_json import known
from surveysim.runtime.table import Column, Table, column, file_column, quoted_columns
from surveysim.scene.spectra import NIGHT
from surveysim.survey.split_spectra import SplitSpectrum, SurveySpectra

Content = Mapping[str, Any]  # entry `split_spectra` of summary.json
MOST_UNSEEN = 0.01  # of the patch
STEEP = 1.25  # ratio of the sky's neighbouring band powers; 1.4 is a bias of 20 % in the lowest bin of a small survey
SUSPECT = 1e-3  # probability to exceed, below which a test has failed
_MEASURED = "power_uk2", "monte_carlo_error_uk2"
_PARTS = {
    "direction": (
        "scans there and scans back, of the same observations. They cover other rows of the field, so their filters"
        " differ by a few percent, which a null test sees in bright skies."
    ),
    "array": "two halves of the array, every second detector, in the same observations.",
}
_SHARED = (
    "The parts share the atmosphere and the cleaning, so their cross-spectrum has a noise bias, which random signs of"
    " the observations measure. It is removed."
)
_BIAS = "noise_bias_uk2", "noise_bias_error_uk2"


def spectra_entry(setup: Setup, spectra: SurveySpectra, done: int) -> dict[str, Any]:
    """Return the entry `split_spectra` of summary.json, `done` being the number of simulated observations."""
    splits = setup.analysis.splits
    return {
        "reported": spectra.reported.split.name,
        "realizations": setup.scene.spectra.realizations,
        "bins": list(_bins(spectra)),
        "splits": {name: _split_entry(splits, item, done) for name, item in spectra.splits.items()},
    }


def _bins(spectra: SurveySpectra) -> Iterator[dict[str, Any]]:
    """Reported band powers, a row for each bin."""
    item = spectra.reported
    powers, relative = item.powers, spectra.transfer_error / spectra.transfer
    expected = np.abs(powers.power_uk2) if spectra.input_uk2 is None else spectra.input_uk2
    columns = {
        "ell_low": powers.ell_low,
        "ell_high": powers.ell_high,
        "ell": powers.ell,
        "n_modes": powers.n_modes,
        "power_uk2": powers.power_uk2,
        "monte_carlo_error_uk2": item.monte_carlo.error_uk2,
        "analytic_error_uk2": powers.covariance.error_uk2,
        "transfer_function_error_uk2": relative * expected,
        "noise_bias_uk2": item.bias_uk2,
        "noise_bias_error_uk2": item.bias_error_uk2,
    }
    columns |= {} if spectra.input_uk2 is None else {"input_uk2": spectra.input_uk2}
    columns |= {} if spectra.sky_uk2 is None else {"sky_uk2": spectra.sky_uk2}
    for place in range(len(powers.ell)):
        yield known({name: float(values[place]) for name, values in columns.items()})


def _split_entry(splits: SurveySplits, item: SplitSpectrum, done: int) -> dict[str, Any]:
    entry: dict[str, Any] = {"parts": list(item.split.parts), "shares_weather": item.shares_weather}
    if item.split.name == NIGHT:
        entry |= _night_counts(splits, done)
    numbers = {"independent_observations": item.independent, "unseen": item.unseen}
    numbers |= {} if item.fit is None else _test("", item.fit)
    return entry | known(numbers | _test("null_", item.null.chi_squared))


def _night_counts(splits: SurveySplits, done: int) -> dict[str, Any]:
    part, night = splits.night_parts[:done], splits.night[:done]
    numbers = range(len(splits.of(NIGHT).parts))
    counts = {"observations": [int(np.sum(part == number)) for number in numbers]}
    return counts | ({"nights": [len(set(night[part == number])) for number in numbers]} if splits.dated else {})


def _test(begin: str, found: ChiSquared) -> dict[str, Any]:
    return {f"{begin}chi_squared": found.value, f"{begin}bins": found.n_bin, f"{begin}pte": found.pte}


def spectra_warnings(spectra: SurveySpectra) -> list[str]:
    """Warn of few observations and realizations, and of parts with holes in their maps."""
    found = [*spectra.reported.powers.flags, *spectra.reported.monte_carlo.flags, *_steep(spectra)]
    tests = {name: item.null.chi_squared for name, item in spectra.splits.items()}
    found += [
        f"the null test of the split {name!r} fails, with a probability to exceed of {test.pte:.2g}"
        for name, test in tests.items()
        if test.pte < SUSPECT
    ]
    for name, item in spectra.splits.items():
        if item.independent < FEWEST:
            found.append(
                f"the noise of the split {name!r} is that of {item.independent:.0f} independent observations; {FEWEST}"
                " or more are needed to trust its errors"
            )
        if item.unseen > MOST_UNSEEN:
            found.append(
                f"a part of the split {name!r} misses {100 * item.unseen:.0f} % of the scored patch, and holes in its"
                " map mix multipoles"
            )
    return [f"spectra: {line}." for line in found]


def _steep(spectra: SurveySpectra) -> list[str]:
    """Warn of a sky whose spectrum is not that of the simulated skies, which is flat."""
    input_uk2 = spectra.input_uk2
    if spectra.own_transfer or input_uk2 is None or not (known := input_uk2[np.isfinite(input_uk2)]).all():
        return []
    change = np.exp(np.abs(np.diff(np.log(known))).max(initial=0.0))
    if change < STEEP:
        return []
    return [
        f"the spectrum of the sky changes by up to a factor of {change:.3g} from one bin to the next, and the transfer"
        " function is that of flat ones; band powers and their chi^2 are biased, most of all in the lowest bins:"
        " score.signal_sims.spectrum = 'sky' measures that of the sky"
    ]


def band_power_table(entry: Content) -> Table:
    """Return the reported band powers with their errors, noise bias and input."""
    rows = entry["bins"]
    of = {name: [row[name] for row in rows] for name in rows[0]}
    columns = [
        Column("ell", of["ell"], "", "ell", tuple(f"{count(row['ell_low'])}-{count(row['ell_high'])}" for row in rows)),
        column("n_modes", of["n_modes"], "modes", count),
        *quoted_columns(_MEASURED, of[_MEASURED[0]], of[_MEASURED[1]], "band power [uK_CMB^2]", unit="uK2"),
        column("analytic_error_uk2", of["analytic_error_uk2"], "analytic error", number, unit="uK2"),
        column("transfer_function_error_uk2", of["transfer_function_error_uk2"], "transfer error", number, unit="uK2"),
        *quoted_columns(_BIAS, of[_BIAS[0]], of[_BIAS[1]], "noise bias", unit="uK2"),
    ]
    headings = {"input_uk2": "spectrum", "sky_uk2": "this sky"}
    columns += [column(name, of[name], heading, number, unit="uK2") for name, heading in headings.items() if name in of]
    return Table("band_power", f"Band powers from the split {entry['reported']!r}", tuple(columns))


def split_table(entry: Content) -> Table:
    """Return chi-squared and PTE of the band powers, and of the null test, of each split."""
    splits = entry["splits"]
    items = list(splits.values())

    def test(begin: str, heading: str) -> list[Column]:
        values, bins, ptes = ([item.get(begin + key) for item in items] for key in ("chi_squared", "bins", "pte"))
        cells = tuple("" if n is None else f"{number(value)} / {n}" for value, n in zip(values, bins, strict=True))
        return [
            Column(f"{begin}chi_squared", values, "", f"{heading} chi^2 / bins", cells),
            column(f"{begin}pte", ptes, "PTE", lambda pte: number(pte, 2)),
        ]

    columns = (
        column("split", list(splits), "split"),
        column("parts", [len(item["parts"]) for item in items], "parts"),
        *test("", "input"),
        *test("null_", "null"),
    )
    return Table("split", "Tests of the splits", columns)


def split_sentences(entry: Content) -> list[str]:
    """Return a sentence on the parts of each split, and on what their noise shares."""
    return [_sentence(name, item) for name, item in entry["splits"].items()]


def _sentence(name: str, item: Content) -> str:
    if name == NIGHT:
        what = "nights" if "nights" in item else "observations"
        counts = joined([short(value) for value in item[what]])
        text = f"{name}: {len(item['parts'])} parts of {counts} {what}, dealt out in turn."
        weather = " Observations of one night share the weather, so a night is never divided."
        return text + weather * ("nights" in item)
    return f"{name}: {_PARTS[name]} {_SHARED}"


def split_spectra_table(spectra: SurveySpectra, meta: Content) -> Table:
    """Return the band powers of all splits, a row for each bin, as tables/split_spectra.ecsv has them."""
    first = spectra.reported.powers
    columns = [
        file_column("ell_low", first.ell_low),
        file_column("ell_high", first.ell_high),
        file_column("ell", first.ell),
        file_column("n_modes", first.n_modes),
        file_column("transfer_function", spectra.transfer),
        file_column("transfer_function_error", spectra.transfer_error),
    ]
    for name, values in (("input", spectra.input_uk2), ("sky", spectra.sky_uk2)):
        columns += [] if values is None else [file_column(name, values, "uK2")]
    for name, item in spectra.splits.items():
        columns += [
            file_column(f"power_{name}", item.powers.power_uk2, "uK2"),
            file_column(f"monte_carlo_error_{name}", item.monte_carlo.error_uk2, "uK2"),
            file_column(f"analytic_error_{name}", item.powers.covariance.error_uk2, "uK2"),
            file_column(f"noise_bias_{name}", item.bias_uk2, "uK2"),
            file_column(f"noise_bias_error_{name}", item.bias_error_uk2, "uK2"),
        ]
    return Table("split_spectra", "Band powers of all splits", tuple(columns), meta=meta)
