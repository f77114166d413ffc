"""Figures of a finished survey as PNG files.

Each figure is one function from results to a `Figure`, drawn with Agg and without any global state.
"""

from collections.abc import Callable
from fractions import Fraction
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from mapmaker.geometry import wcs
from mapmaker.transfer_function import beam_window, pixel_window
from surveysim.forecasting.forecast import Forecast
from surveysim.reduction.cleaning_pipelines import ACTUAL, OPTIMAL
from surveysim.reduction.data_set import DataSetKind
from surveysim.reduction.setup import Setup
from surveysim.report.figures.style import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    LEGEND,
    ORANGE,
    PURPLE,
    SKY,
    VERMILION,
    finish,
    legend,
    new_figure,
    plain_ticks,
    save,
)
from surveysim.survey.coadds import CoAdds
from surveysim.survey.scores import DataSetScore, bin_errors, rescore
from surveysim.telescope.raster import samples_per_scan
from surveysim.timestreams.observed_block import observation_levels

TITLES = {
    "timestream_psd": "time-streams before and after cleaning",
    "map": "co-added map and its noise",
    "map_psd": "PSDs of the maps",
    "window": "what is left of the signal",
    "cumulative_sensitivity": "cumulative sensitivity",
    "weights": "multipoles that the score comes from",
    "weather": "noise of each observation",
}
FULL_COLOUR = ("map", "weather")  # those with a colour bar
LOWEST_ELL = 500  # bins below it hold few modes, and of those little but the map's mean and gradient
DEEPEST = 4  # the map is shown where its noise is at most this many times the lowest

# Colours and dashes of the paper's figure `sim_noise`.
LINES = {"actual": (BLACK, "-"), "uncorrelated": (VERMILION, ":"), "white": (GREEN, "--")}
MASKED_LINE = (BLUE, "-.")
# Of pipelines that the scene compares with its own, and of the best one of each observation.
COMPARED = ((PURPLE, "-"), (ORANGE, "-"), (SKY, "-"), (PURPLE, "--"), (ORANGE, "--"), (SKY, "--"))
OPTIMAL_LINE = (GREY, "-")

ELL = r"Multipole $\ell$"
UK_CMB = r"$\mu$K$_\mathrm{CMB}$"
UK2_CMB = r"$\mu$K$_\mathrm{CMB}^2$"


def drawings(
    setup: Setup, coadds: CoAdds, scores: dict[str, DataSetScore], expected: Forecast | None = None
) -> dict[str, Callable[[Path], None]]:
    """What draws each figure that the scene has results for as a PNG, whole or not at all, by its name.

    Time-stream PSDs and the map where any scan was kept; PSDs, windows, sensitivity and weights of the maps
    with `scores`, PSDs and windows beside those `expected` by forecast; the weather with an atmosphere.
    """
    if not coadds.weight[0].any():
        return {}
    made = {"timestream_psd": lambda: timestream_psd(setup, coadds), "map": lambda: coadded_map(setup, coadds)}
    if scores:
        made["map_psd"] = lambda: map_psds(setup, scores, expected)
        made["window"] = lambda: windows(setup, scores, expected)
        made["cumulative_sensitivity"] = lambda: cumulative_sensitivity(setup, scores)
        made["weights"] = lambda: bin_weights(setup, scores)
    if (coadds.column("b2_mk2") > 0).any():
        made["weather"] = lambda: weather(setup, coadds)

    def draw(name: str, path: Path) -> None:
        figure = made[name]()
        figure.suptitle(f"{setup.scene.name}: {TITLES[name]} ({coadds.done} observations)", fontsize=11)
        save(figure, path, name in FULL_COLOUR)

    return {name: partial(draw, name) for name in made}


def timestream_psd(setup: Setup, coadds: CoAdds) -> Figure:
    """PSDs of the streams before and after cleaning (as the paper's figure `avg_skysub`).

    Good and poor weather are the quarters of the observations with the lowest and the highest B2; one panel
    where B2 does not vary.
    """
    scan, groups = setup.scene.scan, _weather_quarters(setup, coadds)
    frequency = np.fft.rfftfreq(samples_per_scan(setup.observing.raster), 1 / scan.sample_rate_hz)
    # Nothing is left at f = 0 once the mean is removed, and the Nyquist bin holds half as many modes.
    used = (frequency > 0) & (frequency < scan.sample_rate_hz / 2)
    frequency = frequency[used]
    raw, clean = np.array(coadds.raw_psd)[:, used], np.array(coadds.clean_psd)[:, used]
    beam = beam_window(2 * np.pi * frequency / scan.speed_rad_s, setup.scene.instrument.beam_fwhm_rad)
    pairs = np.array([(raw[rows].mean(axis=0), clean[rows].mean(axis=0)) for rows in groups.values()])
    figure, panels = _panels(len(groups), 4.9)
    for axes, (name, rows), (before, after) in zip(panels, groups.items(), pairs, strict=True):
        axes.plot(frequency, before, color=VERMILION, lw=1.8, label="before cleaning")
        cleaned = f"after cleaning ({setup.analysis.pipelines[0].label})"
        axes.plot(frequency, after, color=BLUE, lw=1.8, label=cleaned)
        _white_levels(axes, setup, coadds, rows)
        scaled = r"beam power at $\ell = 2\pi f$ / speed, arbitrary scale"
        axes.plot(frequency, 10 * pairs[:, 1].max() * beam, color=PURPLE, ls=":", lw=1.5, label=scaled)
        axes.set(xscale="log", yscale="log", xlim=(frequency[0], scan.sample_rate_hz / 2))
        levels = [line.get_ydata()[0] for line in axes.lines if len(line.get_ydata()) == 2 and line.get_ydata()[0] > 0]
        axes.set_ylim(min([pairs.min() / 2, *levels]) / 2, pairs.max() * 2)
        axes.set_title(name, fontsize=10)
        finish(axes, "Frequency [Hz]", "Time-stream PSD [mK$^2$/Hz]")
        plain_ticks(axes.xaxis)
    entries = panels[0].get_legend_handles_labels()
    figure.legend(*entries, loc="outside lower center", ncols=1 + len(panels), fontsize=8.5, frameon=False)
    return figure


def coadded_map(setup: Setup, coadds: CoAdds) -> Figure:
    """The co-added map of the actual data, smoothed with the beam, and its noise a pixel, both in uK_CMB.

    The noise is that of the weights: of the scored band, as if white. Nothing is shown where that of the
    smoothed weights is above `DEEPEST` times its minimum.
    """
    from astropy.visualization.wcsaxes import WCSAxes

    signal, noise = _map_planes(setup, coadds)
    rows = setup.analysis.region.patch if setup.analysis.region else slice(None)
    reach = np.nanpercentile(np.abs(signal[rows, rows]), 99.5)
    lowest = np.nanmin(noise)
    side = _short(np.degrees(setup.analysis.geometry.pixel_rad) * 3600)
    shown = (
        (signal, "Signal smoothed with the beam", "RdBu_r", -reach, reach, "both"),
        (noise, f"Noise of {side} arcsec pixels", "cividis_r", lowest, DEEPEST * lowest, "max"),
    )
    figure = new_figure(10, 4)
    for number, (image, label, colours, low, high, extend) in enumerate(shown, start=1):
        axes = figure.add_subplot(1, 2, number, axes_class=WCSAxes, wcs=wcs(setup.analysis.geometry))
        drawn = axes.imshow(image, origin="lower", cmap=colours, vmin=low, vmax=high, interpolation="nearest")
        _sky_axes(axes, setup)
        bar = figure.colorbar(drawn, ax=axes, extend=extend, fraction=0.046, pad=0.03)
        bar.set_label(f"{label} [{UK_CMB}]", fontsize=10)
        bar.ax.tick_params(labelsize=9)
    return figure


def _map_planes(setup: Setup, coadds: CoAdds) -> tuple[np.ndarray, np.ndarray]:
    """Smoothed signal and noise (n_y, n_x) [uK_CMB] of the actual data, NaN where too noisy to show."""
    from scipy.ndimage import gaussian_filter

    instrument, weight = setup.scene.instrument, coadds.weight[0]
    to_ukcmb = 1e3 * instrument.cmb_per_rj
    sigma = instrument.beam_fwhm_rad / np.sqrt(8 * np.log(2)) / setup.analysis.geometry.pixel_rad
    # Sums and weights smoothed apart: noisy pixels count for less in their neighbours.
    total, spread = gaussian_filter(coadds.sums[0], sigma), gaussian_filter(weight, sigma)
    seen = spread > spread.max() / DEEPEST**2
    empty = np.full(weight.shape, np.nan)
    signal = np.divide(total, spread, out=empty.copy(), where=seen)
    noise = np.divide(1, np.sqrt(weight), out=empty, where=seen & (weight > 0))
    return to_ukcmb * signal, to_ukcmb * noise


def map_psds(setup: Setup, scores: dict[str, DataSetScore], expected: Forecast | None = None) -> Figure:
    """Noise PSD of the map of each data set (the paper's figure `sim_noise`), and a signal to hold against.

    The masked array's PSD is multiplied by its share of the detectors: the paper multiplies an amplitude by
    the root of it. Bands are the standard error of `bin_errors`; thin lines the forecast.
    """
    rings, first = setup.analysis.region.rings, next(iter(scores.values()))
    used = _usable(setup)
    ell = rings.ell[used]
    figure, (axes,) = _panels(1)
    for item in scores.values():
        colour, dashes, label, share = _look(setup, item)
        psd = share * item.noise_psd[used]
        error = psd * bin_errors(setup, item)[used]
        axes.fill_between(ell, psd - error, psd + error, color=colour, alpha=0.18, lw=0)
        axes.plot(ell, psd, color=colour, ls=dashes, lw=1.8, label=label)
        if expected and item.name in expected.scores:
            axes.plot(ell, share * expected.scores[item.name].noise_psd[used], color=colour, lw=0.8)
    if expected:
        axes.plot([], [], color=BLACK, lw=0.8, label="forecast of each")
    sigma = first.band.sigma_ukcmb2
    flat = f"flat CMB of {_short(sigma)} {UK2_CMB}, as the map shows it"
    axes.plot(ell, sigma * first.signal_psd[used], color=GREY, lw=1, label=flat)
    _shade_scored(axes, setup)
    lowest = min(_look(setup, item)[3] * item.noise_psd[used].min() for item in scores.values())
    axes.set(xscale="log", yscale="log", xlim=(rings.edges_ell[:-1][used][0], rings.edges_ell[-1]))
    axes.set_ylim(bottom=lowest / 10)
    finish(axes, ELL, f"Map noise PSD [{UK2_CMB} sr]")
    plain_ticks(axes.xaxis)
    _place_legend(setup, figure, axes)
    return figure


def windows(setup: Setup, scores: dict[str, DataSetScore], expected: Forecast | None = None) -> Figure:
    """Power transmission of cleaning (thin lines: forecast), for both arrays, of beam and pixel, and of all."""
    rings, first = setup.analysis.region.rings, next(iter(scores.values()))
    beam = beam_window(rings.ell, setup.scene.instrument.beam_fwhm_rad)
    pixel = pixel_window(rings.ell, setup.scene.map.pixel_rad)
    figure, (axes,) = _panels(1)
    _shade_scored(axes, setup)
    style = {"marker": "o", "ms": 3.5, "lw": 1, "capsize": 2}
    labels = {pipeline.data_set: f"cleaning ({pipeline.label})" for pipeline in setup.analysis.pipelines}
    for item in {id(item.window): item for item in reversed(scores.values())}.values():
        colour, dashes, label, _ = _look(setup, item)
        label = f"{labels.get(item.name, label)}, {item.n_det} detectors"
        axes.errorbar(rings.ell, item.window.transmission, item.window.error, c=colour, ls=dashes, label=label, **style)
        if expected and item.name in expected.scores:
            axes.plot(rings.ell, expected.scores[item.name].transmission, color=colour, lw=0.8)
    if expected:
        axes.plot([], [], color=BLACK, lw=0.8, label="forecast of each")
    axes.plot(rings.ell, beam, color=PURPLE, ls=":", lw=1.8, label=r"beam, $B_\ell^2$")
    axes.plot(rings.ell, pixel, color=GREEN, ls="--", lw=1.5, label="pixel")
    product = beam * pixel * first.window.transmission
    axes.plot(rings.ell, product, color=VERMILION, lw=1.8, label=f"product, {first.n_det} detectors")
    axes.set(xlim=(0, rings.edges_ell[-1]), ylim=(0, 1.1))
    finish(axes, ELL, "Power transmission")
    _place_legend(setup, figure, axes)
    return figure


def cumulative_sensitivity(setup: Setup, scores: dict[str, DataSetScore]) -> Figure:
    """Uncertainty of a flat band power from all data above a multipole (figure `map_psd_ave_plane`, bottom).

    Every bin from `LOWEST_ELL` up starts a range; bands are the Monte Carlo error of its uncertainty. The
    masked array's is multiplied by its share of the detectors, as in Table 3.
    """
    score, edges = setup.scene.score, setup.analysis.region.rings.edges_ell
    starts = edges[:-1][_usable(setup) & (edges[1:] <= score.ell_max)]
    figure, (axes,) = _panels(1)
    for item in scores.values():
        colour, dashes, label, share = _look(setup, item)
        bands = [rescore(setup, item, start).band for start in starts]
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
    """Share of each bin of multipole in the score of each data set, and the effective multipole."""
    figure, (axes,) = _panels(1)
    for item in scores.values():
        colour, dashes, _, _ = _look(setup, item)
        used = item.band.weight > 0
        ell, weight = item.band.ell[used], item.band.weight[used]
        label = rf"{_name(setup, item)}: $\ell_\mathrm{{eff}}$ = {item.band.ell_eff:.0f}"
        axes.plot(ell, weight, color=colour, ls=dashes, marker="o", ms=3.5, label=label)
        axes.axvline(item.band.ell_eff, color=colour, ls=dashes, lw=0.9)
    axes.set_ylim(bottom=0)
    finish(axes, ELL, f"Share in the score of a bin of {setup.scene.score.ell_bin} multipoles")
    _place_legend(setup, figure, axes)
    return figure


def weather(setup: Setup, coadds: CoAdds) -> Figure:
    """Noise of each observation's map of the actual data against B2, coloured by the speed of the wind."""
    b2, wind, white = (coadds.column(name) for name in ("b2_mk2", "wind_speed_rad_s", "white_mk2_hz"))
    noise = coadds.noise_mk2()[:, 0]
    good = np.isfinite(noise) & (noise > 0) & (b2 > 0)
    arcmin_s = np.degrees(wind) * 60
    figure, (axes,) = _panels(1)
    norm = LogNorm(arcmin_s.min(), arcmin_s.max()) if np.ptp(arcmin_s) > 0 else None
    drawn = axes.scatter(
        b2[good], noise[good], c=arcmin_s[good], norm=norm, cmap="viridis", s=18, lw=0.3, edgecolors=BLACK
    )
    if setup.scene.score:
        level = white.mean() * setup.scene.scan.sample_rate_hz / 2
        axes.axhline(level, color=GREY, ls="--", lw=1.2, label="white level of the streams, mean")
        legend(axes)
    axes.set(xscale="log", yscale="log")
    bar = figure.colorbar(drawn, ax=axes)
    bar.set_label("Wind speed [arcmin/s]", fontsize=10)
    if norm is not None:
        plain_ticks(bar.ax.yaxis)
    bar.ax.tick_params(labelsize=9)
    band = " in the scored band" if setup.analysis.region else ""
    finish(axes, f"$B^2$ [{_b2_unit(setup)}]", f"Map noise{band} [mK$^2$ a sample]")
    plain_ticks(axes.yaxis)
    return figure


def _weather_quarters(setup: Setup, coadds: CoAdds) -> dict[str, np.ndarray]:
    """Observations (indices), of those with data, of each panel of the time-stream PSDs, by its title."""
    kept, b2 = np.flatnonzero(np.any(coadds.clean_psd, axis=1)), coadds.column("b2_mk2")
    if not np.ptp(b2[kept]) > 0:
        return {"all observations": kept}
    order, n = kept[np.argsort(b2[kept])], max(1, len(kept) // 4)
    return {
        f"{name} weather: $B^2$ = {_span(b2[rows])} {_b2_unit(setup)}": rows
        for name, rows in (("good", order[:n]), ("poor", order[-n:]))
    }


def _b2_unit(setup: Setup) -> str:
    exponent = Fraction(2 - setup.scene.atmosphere.spectral_index).limit_denominator(100)
    return rf"mK$^2$ rad$^{{{exponent}}}$"


def _short(value: float) -> str:
    """Three digits, without an exponent up to a million."""
    return f"{float(f'{value:.3g}'):g}"


def _span(increasing: np.ndarray) -> str:
    return " to ".join(dict.fromkeys(_short(value) for value in increasing[[0, -1]]))


def _usable(setup: Setup) -> np.ndarray:
    """Bins (n_bin,) bool from `LOWEST_ELL` up, or from the scored range if that starts lower."""
    return setup.analysis.region.rings.edges_ell[:-1] >= min(LOWEST_ELL, setup.scene.score.ell_min)


def _white_levels(axes: Axes, setup: Setup, coadds: CoAdds, rows: np.ndarray) -> None:
    measured = coadds.column("white_mk2_hz")[rows].mean()
    levels = [observation_levels(setup, int(number)) for number in np.arange(coadds.done)[rows]]
    photon = float(np.mean([item.photon_mk2_hz for item in levels]))
    white = photon + float(np.mean([item.detector_mk2_hz for item in levels]))
    levels = (
        (measured, "measured white level", BLACK, "-"),
        (white, "white noise of the scene", GREEN, "-"),
        (photon, "photon noise (BLIP)", GREEN, "--"),
    )
    for level, label, colour, dashes in levels:
        if level > 0:
            axes.axhline(level, color=colour, ls=dashes, lw=1.1, label=label, zorder=1)


def _sky_axes(axes: Axes, setup: Setup) -> None:
    for coordinate, label in zip(axes.coords, ("Right ascension [deg]", "Declination [deg]"), strict=True):
        coordinate.set_major_formatter("d.d")
        coordinate.set_ticklabel(size=9, exclude_overlapping=True)
        coordinate.set_axislabel(label, fontsize=10)
    if setup.scene.score is not None:
        side = setup.scene.score.size_rad / setup.analysis.geometry.pixel_rad
        corner = [(n - side) / 2 - 0.5 for n in (setup.analysis.geometry.n_x, setup.analysis.geometry.n_y)]
        axes.add_patch(Rectangle(corner, side, side, fill=False, ec=BLACK, lw=1.2))
        x, y = (start + side / 40 for start in corner)
        axes.text(x, y, "scored", fontsize=8.5, bbox={"fc": "white", "ec": "none", "alpha": 0.7, "pad": 1.5})


def _look(setup: Setup, item: DataSetScore) -> tuple[str, str, str, float]:
    """Colour, dashes, label and the factor that makes up for detectors left out."""
    if _is_masked(item):
        return (
            *MASKED_LINE,
            rf"{_name(setup, item)}, $\times$ {item.n_det}/{setup.camera.n_det}",
            item.n_det / setup.camera.n_det,
        )
    if item.name == OPTIMAL:
        return *OPTIMAL_LINE, "the best of each observation", 1.0
    compared = [pipeline.data_set for pipeline in setup.analysis.whole_pipelines[1:]]
    if item.name in compared:
        return *COMPARED[compared.index(item.name) % len(COMPARED)], item.name, 1.0
    return *LINES[item.name], _name(setup, item), 1.0


def _is_masked(item: DataSetScore) -> bool:
    return item.kind is DataSetKind.MASKED


def _name(setup: Setup, item: DataSetScore) -> str:
    if _is_masked(item):
        return f"masked, {item.n_det} detectors"
    return (
        f"actual ({setup.analysis.pipelines[0].label})" if item.name == ACTUAL and setup.analysis.chooses else item.name
    )


def _shade_scored(axes: Axes, setup: Setup) -> None:
    score = setup.scene.score
    axes.axvspan(score.ell_min, score.ell_max, color=GREY, alpha=0.12, lw=0, label="scored range")


def _place_legend(setup: Setup, figure: Figure, axes: Axes) -> None:
    """The legend in the axes, or below them where pipelines are compared: that is too many for inside."""
    if setup.analysis.chooses:
        figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=2, **LEGEND)
    else:
        legend(axes)


def _panels(n: int, height: float = 4.6) -> tuple[Figure, list[Axes]]:
    figure = new_figure(10 if n > 1 else 6.4, height)
    return figure, list(figure.subplots(1, n, squeeze=False, sharey=True)[0])
