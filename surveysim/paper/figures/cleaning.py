"""Figures 10, 11 and 12 of the paper: PSDs of time-streams and templates by algorithm, in good and poor weather."""

from dataclasses import dataclass
from math import cos, pi, sin
from typing import Any

import numpy as np

from mapmaker.cleaning import Cleaned, PcaOptions, TemplateOptions, WindOptions, clean, slowness
from mapmaker.cleaning.templates import QUADRATIC, template_streams
from mapmaker.stream_psd import hann_psd
from mapmaker.timestreams import FocalPlane, Timestreams
from mapmaker.transfer_function import beam_window
from mapmaker.wind import scan_velocities
from surveysim.paper.measured_survey import MeasuredSurvey
from surveysim.paper.measurement import WHITE_ABOVE_HZ, Measurement
from surveysim.paper.published import published
from surveysim.paper.statistics import described
from surveysim.reduction.setup import Setup
from surveysim.report.figures.spec import Panel, PaperFigure, Series
from surveysim.runtime.errors import InsufficientDataError
from surveysim.runtime.rng import RandomPurpose, generator
from surveysim.telescope.scans import samples_per_scan
from surveysim.timestreams.observation import draw_observation
from surveysim.timestreams.observed_block import observation_levels
from surveysim.timestreams.response import write_sky_signal
from surveysim.timestreams.simulation import observation_path
from surveysim.timestreams.sky_maps import flat_cmb_sky

CENTILES = {"good": 25.0, "poor": 75.0}  # centiles of B2
ALGORITHMS = ("none", "average", "wind", "planar", "quadratic")
LOOKS = {
    "none": "black",
    "average": "blue",
    "wind": "orange --",
    "planar": "green",
    "quadratic": "vermilion",
    "pca": "vermilion --",
}
NAMES = {"none": "before cleaning", "wind": "wind model", "pca": "adaptive PCA"}
RATIO_LOOKS = {"pca": "vermilion -.", "average": "blue :"}
TERMS = {"1": "black", "$x$": "blue", "$y$": "sky --", "$xy$": "green", "$x^2$": "vermilion", "$y^2$": "orange --"}
PCA_SIGMA_CUT = 3.0  # section 4.4
ATMOSPHERE_HZ = 0.5  # section 4.3: above it the atmosphere is negligible
SIGNAL_BAND_POWER_UKCMB2 = 1000.0  # too faint to change what cleaning does
FAINTEST_BEAM = 0.1  # power of the beam below which too little signal is left for a transfer function
FREQUENCY, PSD = "Frequency [Hz]", "PSD [mK$^2$/Hz]"


@dataclass(frozen=True)
class Example:
    """Observation in good or poor `weather` with its time-streams; `b2` is the fitted value."""

    weather: str
    setup: Setup
    scene: str
    item: Measurement
    b2: float
    streams: Timestreams

    @property
    def title(self) -> str:
        """Title of a panel: weather and B2."""
        return rf"{self.weather} weather: $B_\nu^2$ = {self.b2:.0f} mK$^2$ rad$^{{-5/3}}$"

    def clean(self, name: str, added_mk: np.ndarray | None = None) -> Cleaned:
        """Clean the time-streams plus a signal (n_det, n_samp); InsufficientDataError if no scan is kept."""
        data = self.streams.data_mk if added_mk is None else self.streams.data_mk + added_mk
        cleaned = clean(name, data, self.streams.scan_bounds, self.streams.focal_plane, options=self._options(name))
        if not cleaned.kept.any():
            raise InsufficientDataError(
                f"found no scan of observation {self.item.observation} kept by {name}; one is expected"
            )
        return cleaned

    def psd(self, data_mk: np.ndarray, kept: np.ndarray) -> np.ndarray:
        """PSDs (n, n_freq) [mK^2/Hz] of time-streams at `frequencies`, averaged over kept scans."""
        scans = self.setup.observing.scans
        return hann_psd(data_mk, scans.n_scans, kept, scans.sample_rate_hz)[:, 1 : 1 + len(frequencies(self.setup))]

    def _options(self, name: str) -> Any:
        section = self.setup.scene.cleaning
        template = (section.tolerance, section.max_iterations, self.setup.analysis.responsivities)
        if name == "pca":
            return PcaOptions(PCA_SIGMA_CUT)
        if name == "wind":
            delays = slowness(self.item.wind.velocity_rad_s, scan_velocities(self.streams))
            return WindOptions(delays, self.setup.observing.scans.sample_rate_hz, *template)
        return TemplateOptions(*template)


def frequencies(setup: Setup) -> np.ndarray:
    """Frequencies [Hz] of the modes of a scan, zero and Nyquist frequency excluded."""
    n = samples_per_scan(setup.observing.scans)
    return np.arange(1, (n + 1) // 2) * (setup.observing.scans.sample_rate_hz / n)


def weather_examples(survey: MeasuredSurvey) -> tuple[Example, ...]:
    """Observations of the first scene with fitted B2 nearest to the quartiles of the survey, and with a trusted wind.

    Raises
    ------
    InsufficientDataError
        For fewer than two observations with a fit and a trusted wind.
    """
    first = np.array(survey.scene_of) == survey.scene_of[0]
    usable = np.flatnonzero(first & survey.wind_good & np.isfinite(survey.b2_fitted))
    if len(usable) < 2:
        raise InsufficientDataError(
            f"found {len(usable)} observations with a trusted wind and a fit; two or more are expected"
        )
    examples, log_b2 = [], np.log(survey.b2_fitted)
    for weather, centile in CENTILES.items():
        away = np.abs(log_b2[usable] - np.nanpercentile(log_b2, centile))
        k = int(usable[np.argmin(away)])
        item = survey.measurements[k]
        streams = draw_observation(survey.setup, item.observation)
        examples.append(Example(weather, survey.setup, survey.scene_of[k], item, float(survey.b2_fitted[k]), streams))
    return tuple(examples)


def _chosen(examples: tuple[Example, ...]) -> str:
    each = " and ".join(f"{one.item.observation} of {one.scene} ({one.weather} weather)" for one in examples)
    return f"the two observations with a trusted wind and fitted B2 nearest its quartiles are {each}"


# ---------------------------------------------------------------- figure 10


def timestream_figure(survey: MeasuredSurvey) -> PaperFigure:
    """Figure 10: time-stream PSDs before cleaning and after each algorithm, in good and in poor weather.

    Raises
    ------
    InsufficientDataError
        As for `weather_examples`, and if an algorithm keeps no scan of an observation.
    """
    examples = weather_examples(survey)
    spectra = [{name: _mean_psd(one, one.clean(name)) for name in ALGORITHMS} for one in examples]
    # One scale for both columns, so that they can be compared.
    highest = max(psds["none"].max() for psds in spectra)
    cleaned = np.array([psds[name] for psds in spectra for name in ALGORITHMS[1:]])
    photon = min(photon_level(one) or np.inf for one in examples)
    lowest = min(cleaned.min(), photon) / 2
    columns = [(one, _stream_series(one, psds, cleaned.max())) for one, psds in zip(examples, spectra, strict=True)]
    panels = [_psd_panel(one.title, series, (lowest, 2 * highest)) for one, series in columns]
    panels += [
        _psd_panel(f"{one.weather} weather, after cleaning", series, (lowest, 2 * cleaned.max()))
        for one, series in columns
    ]
    caption = (
        f"{described(survey)}; {_chosen(examples)}. Hann-tapered PSDs of single scans, averaged over all kept scans"
        f" and all detectors; the lower row is the upper one in part. Dotted: power of the beam at the multipole that a"
        f" frequency has at the scan speed; dashed: photon noise. Power below {ATMOSPHERE_HZ:g} Hz over that which the"
        f" average leaves: {_left(examples, spectra)}. The paper finds no gain from the wind model, and a slight one"
        f" at low frequencies from planar and quadratic subtraction."
    )
    return PaperFigure(10, "Time-streams before and after cleaning", caption, tuple(panels), len(examples))


def _mean_psd(one: Example, cleaned: Cleaned) -> np.ndarray:
    return one.psd(cleaned.data_mk, cleaned.kept).mean(axis=0)


def _stream_series(one: Example, psds: dict[str, np.ndarray], beam_at: float) -> list[Series]:
    frequency, photon = frequencies(one.setup), photon_level(one)
    series = [_line(NAMES.get(name, name), frequency, psd, LOOKS[name]) for name, psd in psds.items()]
    series.append(_line("beam, arbitrary scale", frequency, beam_at * beam_power(one.setup), "purple :"))
    if photon:
        series.append(_line("photon noise (BLIP)", frequency, np.full(len(frequency), photon), "grey --"))
    return series


def photon_level(one: Example) -> float:
    """Photon noise [mK^2/Hz] of an observation; 0 without [photon]."""
    return observation_levels(one.setup, one.item.observation).photon_mk2_hz


def beam_power(setup: Setup) -> np.ndarray:
    """Beam window function (n_freq,) of a scanned signal, at ell = 2 pi f / speed."""
    ell = 2 * pi * frequencies(setup) / setup.scene.scan.speed_rad_s
    return beam_window(ell, setup.scene.instrument.beam_fwhm_rad)


def _left(examples: tuple[Example, ...], spectra: list[dict[str, np.ndarray]]) -> str:
    texts = []
    for one, psds in zip(examples, spectra, strict=True):
        low = frequencies(one.setup) <= ATMOSPHERE_HZ
        power = {name: psd[low].sum() / psds["average"][low].sum() for name, psd in psds.items()}
        each = [f"{NAMES.get(name, name)} {value:.3g}" for name, value in power.items() if name != "average"]
        texts.append(f"{', '.join(each)} in {one.weather} weather")
    return "; ".join(texts)


# ---------------------------------------------------------------- figure 11


def template_figure(survey: MeasuredSurvey) -> PaperFigure:
    """Figure 11: PSDs of the six quadratic templates halfway to the array's edge, in good and in poor weather.

    Errors as for `timestream_figure`.
    """
    examples = weather_examples(survey)
    spectra = [template_psds(one) for one in examples]
    ends = (min(psds.min() for psds in spectra) / 2, 2 * max(psds.max() for psds in spectra))
    frequency, paper = frequencies(survey.setup), published()["cleaning"]
    panels = [
        _psd_panel(
            one.title,
            [_line(name, frequency, psd, look) for (name, look), psd in zip(TERMS.items(), psds, strict=True)],
            ends,
        )
        for one, psds in zip(examples, spectra, strict=True)
    ]
    low, high = frequency <= ATMOSPHERE_HZ, frequency > WHITE_ABOVE_HZ
    good, poor = (psds[:, low].sum(axis=1) for psds in spectra)
    noise = np.mean([psds[1:, high].mean() / psds[0, high].mean() for psds in spectra])
    caption = (
        f"{described(survey)}; {_chosen(examples)}. The elements of p_n that quadratic subtraction fits, each times its"
        f" term x^a y^b at a place halfway from the centre of the array to its edge, on the diagonal of its axes,"
        f" where no term is zero. The five higher orders have, below {ATMOSPHERE_HZ:g} Hz, {_share(good)} of the zeroth"
        f" order's power in good and {_share(poor)} in poor weather, and {noise:.2g} above {WHITE_ABOVE_HZ:g} Hz, where"
        f" all are noise; the paper says about {paper['higher_order_template_psd_ratio']:g}, more in worse weather, of"
        f" no frequency in particular. From good to poor weather the amplitude below {ATMOSPHERE_HZ:g} Hz grows by"
        f" {np.sqrt(poor[1:].sum() / good[1:].sum()):.1f} in the higher orders (paper about"
        f" {paper['higher_order_template_growth']:g}) and by {np.sqrt(poor[0] / good[0]):.1f} in the zeroth."
    )
    return PaperFigure(11, "Templates of quadratic subtraction", caption, tuple(panels), len(examples))


def _share(power: np.ndarray) -> str:
    """Words for captions: smallest and largest power ratio of higher orders to the zeroth, and of amplitudes."""
    low, high = np.sort(power[1:] / power[0])[[0, -1]]
    return f"{low:.2g} to {high:.2g} (in amplitude {np.sqrt(low):.2g} to {np.sqrt(high):.2g})"


def template_psds(one: Example) -> np.ndarray:
    """PSDs (6, n_freq) [mK^2/Hz] of the quadratic templates at `halfway_out`; errors as for `Example.clean`."""
    plane, cleaned = one.streams.focal_plane, one.clean("quadratic")
    bounds, place = one.streams.scan_bounds, halfway_out(plane)
    streams = template_streams(
        one.streams.data_mk, bounds, plane, responsivity=cleaned.responsivity, exponents=QUADRATIC, place_rad=place
    )
    return one.psd(streams, cleaned.kept)


def halfway_out(plane: FocalPlane) -> tuple[float, float]:
    """Position [rad] on the diagonal, halfway from the centre of the array to its outermost detector."""
    x, y = float(np.mean(plane.x_rad)), float(np.mean(plane.y_rad))
    half = float(np.hypot(plane.x_rad - x, plane.y_rad - y).max()) / 2
    return x + half * cos(pi / 4), y + half * sin(pi / 4)


# ---------------------------------------------------------------- figure 12


@dataclass(frozen=True)
class Cost:
    """Noise PSD and signal transfer function after cleaning, (n_freq,); `removed` modes."""

    psd: np.ndarray
    transfer_function: np.ndarray
    removed: float


def pca_figure(survey: MeasuredSurvey) -> PaperFigure:
    """Figure 12: PSDs and signal-to-noise ratios after average subtraction and adaptive PCA, in good and poor weather.

    Errors as for `timestream_figure`.
    """
    examples = weather_examples(survey)
    seen = beam_power(survey.setup) > FAINTEST_BEAM
    found = [{name: cleaning_cost(one, name) for name in ("average", "pca")} for one in examples]
    every = [cost for costs in found for cost in costs.values()]
    highest = max(cost.psd.max() for cost in every)
    # One scale for all, so that the algorithms can be compared.
    scale = highest / max((cost.transfer_function / cost.psd)[seen].max() for cost in every)
    ratios = np.concatenate([scale * (cost.transfer_function / cost.psd)[seen] for cost in every])
    ends = (min(ratios.min(), *(cost.psd.min() for cost in every)) / 2, 2 * highest)
    panels = [
        _psd_panel(one.title, _cost_series(one, costs, seen, scale), ends)
        for one, costs in zip(examples, found, strict=True)
    ]
    texts = [_compared(one, costs) for one, costs in zip(examples, found, strict=True)]
    modes = published()["cleaning"]["modes_removed_by_pca"]
    caption = (
        f"{described(survey)}; {_chosen(examples)}. S/N: transfer function of the time-streams for a CMB sky of flat"
        f" band power, over the noise PSD, where the beam leaves more than {100 * FAINTEST_BEAM:g} % of the power; the"
        f" sky of {SIGNAL_BAND_POWER_UKCMB2:g} uK_CMB^2 is far fainter than"
        f" the noise, and scans in which it changes the number of modes are left out. Adaptive PCA cuts eigenvalues"
        f" {PCA_SIGMA_CUT:g} sigma above the mean of their logarithms. {' '.join(texts)} The paper removes"
        f" {modes[0]} or {modes[1]} modes; its PCA has slightly less noise in good weather, slightly more in bad, and"
        f" the lower signal to noise in both."
    )
    return PaperFigure(12, "Average subtraction and adaptive PCA", caption, tuple(panels), len(examples))


def _cost_series(one: Example, costs: dict[str, Cost], seen: np.ndarray, scale: float) -> list[Series]:
    """Series of PSDs and of ratios, dotted lines last, so that both are visible where they agree."""
    frequency = frequencies(one.setup)
    psds = [_line(f"{NAMES.get(name, name)}: PSD", frequency, cost.psd, LOOKS[name]) for name, cost in costs.items()]
    ratios = [
        _line(
            f"{NAMES.get(name, name)}: S/N, arbitrary units",
            frequency[seen],
            scale * (costs[name].transfer_function / costs[name].psd)[seen],
            look,
        )
        for name, look in RATIO_LOOKS.items()
    ]
    return psds + ratios


def cleaning_cost(one: Example, name: str) -> Cost:
    """Noise PSD and signal transfer function after cleaning; errors as for `Example.clean`.

    The signal is the difference that a faint CMB sky makes in the cleaned time-streams, relative to its own
    mean-removed streams. Scans in which the sky changes the number of removed modes are left out.
    """
    setup, plain = one.setup, np.empty_like(one.streams.data_mk)
    _, pointing = observation_path(setup.observing, one.item.observation)
    instrument = setup.scene.instrument
    sky = flat_cmb_sky(
        setup.sky.geometry,
        SIGNAL_BAND_POWER_UKCMB2,
        instrument.cmb_per_rj,
        instrument.beam_fwhm_rad,
        generator(setup.scene.seed, RandomPurpose.SIGNAL_SIM),
    )
    write_sky_signal(setup, pointing, sky, plain)
    base, both = one.clean(name), one.clean(name, plain)
    same = base.kept & both.kept & (base.removed == both.removed)
    if not same.any():
        raise InsufficientDataError(
            f"found no scan in which {name} takes as many modes with a faint sky; one is expected"
        )
    left = one.psd(both.data_mk - base.data_mk, same).mean(axis=0)
    none = clean("none", plain, one.streams.scan_bounds, one.streams.focal_plane, options=None)
    whole = one.psd(none.data_mk, same).mean(axis=0)
    return Cost(_mean_psd(one, base), left / whole, float(base.removed[base.kept].mean()))


def _compared(one: Example, costs: dict[str, Cost]) -> str:
    """Words for captions: noise, transfer function and signal-to-noise ratio of PCA relative to average subtraction."""
    low = frequencies(one.setup) <= ATMOSPHERE_HZ
    average, pca = costs["average"], costs["pca"]
    noise = pca.psd[low].sum() / average.psd[low].sum()
    signal = np.mean(pca.transfer_function[low]) / np.mean(average.transfer_function[low])
    worth = np.sum((pca.transfer_function / pca.psd)[low]) / np.sum((average.transfer_function / average.psd)[low])
    return (
        f"In {one.weather} weather it takes {pca.removed:.1f} modes a scan; below {ATMOSPHERE_HZ:g} Hz it leaves"
        f" {noise:.2f} times the noise power of the average, {signal:.2f} times its transfer function and"
        f" {worth:.2f} times its signal to noise."
    )


# ---------------------------------------------------------------- panels


def _line(label: str, frequency: np.ndarray, psd: np.ndarray, look: str) -> Series:
    return Series(label, "line", frequency, psd, look)


def _psd_panel(title: str, series: list[Series], y_range: tuple[float, float]) -> Panel:
    ends = series[0].x[[0, -1]]
    return Panel(
        title=title,
        x_label=FREQUENCY,
        y_label=PSD,
        series=tuple(series),
        x_log=True,
        y_log=True,
        x_range=(float(ends[0]), float(ends[1])),
        y_range=(float(y_range[0]), float(y_range[1])),
    )
