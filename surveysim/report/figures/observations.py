"""Figures of the observations of a run: PSDs of their time-streams, and noise against weather."""

from fractions import Fraction

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from mapmaker.transfer_function import beam_window
from surveysim.reduction.setup import Setup
from surveysim.report.figures.style import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    PURPLE,
    VERMILION,
    finish,
    legend,
    panels,
    plain_ticks,
    three_digits,
)
from surveysim.survey.coadds import CoAdds
from surveysim.telescope.scans import samples_per_scan
from surveysim.timestreams.observed_block import observation_levels
from surveysim.timestreams.simulation import camera_white


def timestream_psd(setup: Setup, coadds: CoAdds) -> Figure:
    """Draw PSDs of the streams before and after cleaning (as the paper's figure `avg_skysub`).

    Good and poor weather are the quarters of the observations with the lowest and the highest B2; one panel if B2 does
    not vary.
    """
    scan, groups = setup.scene.scan, _weather_quarters(setup, coadds)
    frequency = np.fft.rfftfreq(samples_per_scan(setup.observing.scans), 1 / scan.sample_rate_hz)
    # Nothing is left at f = 0 once the mean is removed, and the Nyquist bin holds half as many modes.
    used = (frequency > 0) & (frequency < scan.sample_rate_hz / 2)
    frequency = frequency[used]
    raw, clean = np.array(coadds.raw_psd)[:, used], np.array(coadds.clean_psd)[:, used]
    beam = beam_window(2 * np.pi * frequency / scan.speed_rad_s, setup.scene.instrument.beam_fwhm_rad)
    pairs = np.array([(raw[rows].mean(axis=0), clean[rows].mean(axis=0)) for rows in groups.values()])
    figure, all_axes = panels(len(groups), 4.9)
    for axes, (name, rows), (before, after) in zip(all_axes, groups.items(), pairs, strict=True):
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
    entries = all_axes[0].get_legend_handles_labels()
    figure.legend(*entries, loc="outside lower center", ncols=1 + len(all_axes), fontsize=8.5, frameon=False)
    return figure


def weather(setup: Setup, coadds: CoAdds) -> Figure:
    """Draw the noise of each observation's map of the actual data against B2, coloured by wind speed."""
    b2, wind, white = (coadds.column(name) for name in ("b2_mk2", "wind_speed_rad_s", "white_mk2_hz"))
    noise = coadds.noise_mk2()[:, 0]
    good = np.isfinite(noise) & (noise > 0) & (b2 > 0)
    arcmin_s = np.degrees(wind) * 60
    figure, (axes,) = panels(1)
    norm = LogNorm(arcmin_s.min(), arcmin_s.max()) if np.ptp(arcmin_s) > 0 else None
    drawn = axes.scatter(
        b2[good], noise[good], c=arcmin_s[good], norm=norm, cmap="viridis", s=18, lw=0.3, edgecolors=BLACK
    )
    if setup.scene.score:
        level = white.mean() * setup.scene.scan.sample_rate_hz / 2
        axes.axhline(level, color=GREY, ls="--", lw=1.2, label="white level of the streams, mean")
        legend(axes)
    axes.set(xscale="log", yscale="log")
    bar = figure.colorbar(drawn, ax=axes, fraction=0.05, pad=0.04)
    bar.set_label("Wind speed [arcmin/s]", fontsize=10)
    if norm is not None:
        plain_ticks(bar.ax.yaxis, (1, 1.5, 2, 3, 4, 5, 6, 8))
    bar.ax.tick_params(labelsize=9)
    finish(axes, f"$B^2$ [{_b2_unit(setup)}]", "Map noise, variance of a sample [mK$^2$]")
    plain_ticks(axes.yaxis)
    return figure


def _weather_quarters(setup: Setup, coadds: CoAdds) -> dict[str, np.ndarray]:
    """Indices of the observations with data in each panel of the time-stream PSDs, by its title."""
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


def _span(increasing: np.ndarray) -> str:
    return " to ".join(dict.fromkeys(three_digits(value) for value in increasing[[0, -1]]))


def _white_levels(axes: Axes, setup: Setup, coadds: CoAdds, rows: np.ndarray) -> None:
    measured = coadds.column("white_mk2_hz")[rows].mean()
    numbers = np.arange(coadds.done)[rows]
    drawn = [camera_white(setup.camera, observation_levels(setup, int(number))) for number in numbers]
    photon = float(np.mean([item.shared + item.alone for item in drawn]))
    white = float(np.mean([item.mean for item in drawn]))
    levels = (
        (measured, "measured white level", BLACK, "-"),
        (white, "white noise of the scene", GREEN, "-"),
        (photon, "photon noise (BLIP)", GREEN, "--"),
    )
    for level, label, colour, dashes in levels:
        if level > 0:
            axes.axhline(level, color=colour, ls=dashes, lw=1.1, label=label, zorder=1)
