"""Figures of map spectra: noise PSDs, transfer functions, cumulative sensitivity, weights of bins."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mapmaker.transfer_function import pixel_window
from surveysim.forecasting.forecast import Forecast
from surveysim.reduction.cleaning_pipelines import ACTUAL, OPTIMAL
from surveysim.reduction.data_set import DataSetKind, scaled_name
from surveysim.reduction.setup import Setup
from surveysim.report.figures.style import (
    BLACK,
    BLUE,
    ELL,
    GREEN,
    GREY,
    LEGEND,
    ORANGE,
    PURPLE,
    SKY,
    UK2_CMB,
    VERMILION,
    finish,
    legend,
    panels,
    plain_ticks,
    three_digits,
)
from surveysim.survey.scores import DataSetScore, bin_errors, rescore

LOWEST_ELL = 500  # bins below it have few modes, mostly the mean and the gradient of the map

# Colours and dashes of the paper's figure `sim_noise`.
LINES = {"actual": (BLACK, "-"), "uncorrelated": (VERMILION, ":"), "white": (GREEN, "--")}
MASKED_LINE = (BLUE, "-.")
# Of pipelines that the scene compares with its own, and of the best one of each observation.
COMPARED = ((PURPLE, "-"), (ORANGE, "-"), (SKY, "-"), (PURPLE, "--"), (ORANGE, "--"), (SKY, "--"))
OPTIMAL_LINE = (GREY, "-")


def map_psds(setup: Setup, scores: dict[str, DataSetScore], expected: Forecast | None = None) -> Figure:
    """Draw the noise PSD of the map of each data set (the paper's figure `sim_noise`), and a flat spectrum for
    comparison.

    The PSD of the masked array is multiplied by its fraction of the detectors: the paper multiplies the amplitude by
    the root. Bands are the standard errors of `bin_errors`, thin lines the forecast.
    """
    rings, first = setup.analysis.region.rings, next(iter(scores.values()))
    used = _usable(setup)
    ell = rings.ell[used]
    figure, (axes,) = panels(1)
    for item in scores.values():
        colour, dashes, label, share = _look(setup, item)
        psd = share * item.noise_psd[used]
        error = psd * bin_errors(setup.analysis, item)[used]
        axes.fill_between(ell, psd - error, psd + error, color=colour, alpha=0.18, lw=0)
        axes.plot(ell, psd, color=colour, ls=dashes, lw=1.8, label=label)
        if expected and item.name in expected.scores:
            axes.plot(ell, share * expected.scores[item.name].noise_psd[used], color=colour, lw=0.8)
    if expected:
        axes.plot([], [], color=BLACK, lw=0.8, label="forecast of each")
    sigma = first.band.sigma_ukcmb2
    flat = f"flat CMB of {three_digits(sigma)} {UK2_CMB}, as the map shows it"
    axes.plot(ell, sigma * first.signal_psd[used], color=GREY, lw=1, label=flat)
    _shade_scored(axes, setup)
    lowest = min(_look(setup, item)[3] * item.noise_psd[used].min() for item in scores.values())
    axes.set(xscale="log", yscale="log", xlim=(rings.edges_ell[:-1][used][0], rings.edges_ell[-1]))
    axes.set_ylim(bottom=lowest / 10)
    finish(axes, ELL, f"Map noise PSD [{UK2_CMB} sr]")
    plain_ticks(axes.xaxis)
    _place_legend(setup, figure, axes)
    return figure


def transfer_functions(setup: Setup, scores: dict[str, DataSetScore], expected: Forecast | None = None) -> Figure:
    """Draw power transfer functions of cleaning for both arrays (thin lines: forecast), of beam and pixel, and their
    product.
    """
    rings, first = setup.analysis.region.rings, next(iter(scores.values()))
    beam = setup.analysis.beams.window(rings.ell)
    pixel = pixel_window(rings.ell, setup.scene.map.pixel_rad)
    figure, (axes,) = panels(1)
    _shade_scored(axes, setup)
    style = {"marker": "o", "ms": 3.5, "lw": 1, "capsize": 2}
    labels = {pipeline.data_set: f"cleaning ({pipeline.label})" for pipeline in setup.analysis.pipelines}
    for item in {id(item.transfer_function): item for item in reversed(scores.values())}.values():
        colour, dashes, label, _ = _look(setup, item)
        label = f"{labels.get(item.name, label)}, {item.n_det} detectors"
        axes.errorbar(
            rings.ell,
            item.transfer_function.transmission,
            item.transfer_function.error,
            c=colour,
            ls=dashes,
            label=label,
            **style,
        )
        if expected and item.name in expected.scores:
            axes.plot(rings.ell, expected.scores[item.name].transmission, color=colour, lw=0.8)
    if expected:
        axes.plot([], [], color=BLACK, lw=0.8, label="forecast of each")
    axes.plot(rings.ell, beam, color=PURPLE, ls=":", lw=1.8, label=r"beam, $B_\ell^2$")
    axes.plot(rings.ell, pixel, color=GREEN, ls="--", lw=1.5, label="pixel")
    product = beam * pixel * first.transfer_function.transmission
    axes.plot(rings.ell, product, color=VERMILION, lw=1.8, label=f"product, {first.n_det} detectors")
    axes.set(xlim=(0, rings.edges_ell[-1]), ylim=(0, 1.1))
    finish(axes, ELL, "Power transmission")
    _place_legend(setup, figure, axes)
    return figure


def cumulative_sensitivity(setup: Setup, scores: dict[str, DataSetScore]) -> Figure:
    """Draw the uncertainty of a flat band power from all data above a multipole (figure `map_psd_ave_plane`, bottom).

    Each bin from `LOWEST_ELL` on starts a range; bands are Monte Carlo errors. The value of the masked array is
    multiplied by its fraction of the detectors, as in Table 3.
    """
    score, edges = setup.scene.score, setup.analysis.region.rings.edges_ell
    starts = edges[:-1][_usable(setup) & (edges[1:] <= score.ell_max)]
    figure, (axes,) = panels(1)
    for item in scores.values():
        colour, dashes, label, share = _look(setup, item)
        bands = [rescore(setup.analysis, item, start).band for start in starts]
        sigma = share * np.array([band.sigma_ukcmb2 for band in bands])
        error = share * np.array([band.error_ukcmb2 for band in bands])
        axes.fill_between(starts, sigma - error, sigma + error, color=colour, alpha=0.18, lw=0)
        axes.plot(starts, sigma, color=colour, ls=dashes, lw=1.8, label=label)
    axes.axvline(score.ell_min, color=GREY, lw=1, label=rf"score from $\ell$ = {score.ell_min}")
    axes.set(yscale="log", xlim=(starts[0], score.ell_max))
    finish(axes, r"Lowest multipole $\ell$ used", rf"Uncertainty of a flat band power [{UK2_CMB}]")
    _place_legend(setup, figure, axes)
    return figure


def bin_weights(setup: Setup, scores: dict[str, DataSetScore]) -> Figure:
    """Draw the contribution of each bin to the score of each data set, and the effective multipole."""
    figure, (axes,) = panels(1)
    for item in scores.values():
        colour, dashes, _, _ = _look(setup, item)
        used = item.band.weight > 0
        ell, weight = item.band.ell[used], item.band.weight[used]
        label = rf"{_name(setup, item)}: $\ell_\mathrm{{eff}}$ = {item.band.ell_eff:.0f}"
        axes.plot(ell, weight, color=colour, ls=dashes, marker="o", ms=3.5, label=label)
        axes.axvline(item.band.ell_eff, color=colour, ls=dashes, lw=0.9)
    axes.set_ylim(bottom=0)
    finish(axes, ELL, rf"Share of each bin of {setup.scene.score.ell_bin} multipoles in $\sigma(A)^{{-2}}$")
    _place_legend(setup, figure, axes)
    return figure


def _usable(setup: Setup) -> np.ndarray:
    """Bins (n_bin,) bool from `LOWEST_ELL`, or from the scored range if that starts lower."""
    return setup.analysis.region.rings.edges_ell[:-1] >= min(LOWEST_ELL, setup.scene.score.ell_min)


def _look(setup: Setup, item: DataSetScore) -> tuple[str, str, str, float]:
    """Colour, dashes, label, and the factor for the missing detectors."""
    if _is_masked(item):
        return *MASKED_LINE, scaled_name(item.name), item.n_det / setup.camera.n_det
    if item.name == OPTIMAL:
        return *OPTIMAL_LINE, "the best of each observation", 1.0
    compared = [pipeline.data_set for pipeline in setup.analysis.whole_pipelines[1:]]
    if item.name in compared:
        return *COMPARED[compared.index(item.name) % len(COMPARED)], item.name, 1.0
    return *LINES[item.name], _name(setup, item), 1.0


def _is_masked(item: DataSetScore) -> bool:
    return item.kind is DataSetKind.MASKED


def _name(setup: Setup, item: DataSetScore) -> str:
    labelled = item.name == ACTUAL and setup.analysis.chooses
    return f"actual ({setup.analysis.pipelines[0].label})" if labelled else item.name


def _shade_scored(axes: Axes, setup: Setup) -> None:
    score = setup.scene.score
    # Edges show the range in a legend that lies on it.
    span = {"facecolor": (GREY, 0.12), "edgecolor": (GREY, 0.6), "lw": 0.6, "label": "scored range"}
    axes.axvspan(score.ell_min, score.ell_max, **span)


def _place_legend(setup: Setup, figure: Figure, axes: Axes) -> None:
    """Place the legend in the axes, or below them if pipelines are compared, because it is long."""
    if setup.analysis.chooses:
        figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=2, **LEGEND)
    else:
        legend(axes)
