"""Figure of band powers from split maps, and of their null tests."""

from matplotlib.figure import Figure

from surveysim.report.figures.style import BLACK, BLUE, ELL, GREEN, GREY, UK2_CMB, VERMILION, finish, legend, new_figure
from surveysim.survey.split_spectra import SurveySpectra

_COLOURS = (BLUE, VERMILION, GREEN)
_MARKERS = ("o", "s", "^")
_APART = 0.12  # of a bin, between the points of two splits


def split_spectra(spectra: SurveySpectra) -> Figure:
    """Draw the reported band powers beside those of the simulated sky, and the null tests in units of their errors."""
    figure = new_figure(10, 4.6)
    left, right = figure.subplots(1, 2)
    item = spectra.reported
    powers = item.powers
    ell, half = powers.ell, (powers.ell_high - powers.ell_low) / 2
    style = {"fmt": "o", "ms": 4, "lw": 1, "capsize": 2, "color": BLACK}
    error = item.monte_carlo.error_uk2
    left.errorbar(ell, powers.power_uk2, error, xerr=half, label=f"split by {item.split.name}", **style)
    left.axhline(0, color=GREY, lw=0.8)
    if spectra.input_uk2 is not None:
        left.plot(ell, spectra.input_uk2, color=VERMILION, lw=1.5, label="spectrum of the simulated sky")
    if spectra.sky_uk2 is not None:
        left.plot(ell, spectra.sky_uk2, "D", color=VERMILION, mfc="none", ms=6, label="the simulated sky itself")
    finish(left, ELL, rf"$\ell(\ell+1)C_\ell/2\pi$ [{UK2_CMB}]")
    legend(left)
    right.axhspan(-1, 1, color=GREY, alpha=0.2, lw=0)
    for place, (name, split) in enumerate(spectra.splits.items()):
        shift = (place - (len(spectra.splits) - 1) / 2) * _APART * 2 * half
        pulls = split.null.power_uk2 / split.null.error_uk2
        look = {"color": _COLOURS[place], "ms": 5, "label": f"{name}: PTE {split.null.chi_squared.pte:.2g}"}
        right.plot(ell + shift, pulls, _MARKERS[place], **look)
    right.axhline(0, color=GREY, lw=0.8)
    right.set_xlabel(ELL, fontsize=10)
    right.set_ylabel("Null power over its error", fontsize=10)
    right.tick_params(which="both", labelsize=9, direction="in", top=True, right=True)
    right.grid(alpha=0.25, lw=0.5)
    low, high = right.get_ylim()
    right.set_ylim(low, high + 0.3 * (high - low))  # room for the legend
    legend(right)
    return figure
