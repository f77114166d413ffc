"""Values of each observation of a survey from which the findings follow, measured in one simulation of its streams."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from math import radians

import numpy as np

from mapmaker.cleaning import Cleaned
from mapmaker.cleaning.templates import QUADRATIC, template_streams
from mapmaker.kernels.pixels import bin_samples
from mapmaker.stream_psd import hann_psd
from surveysim.atmosphere.detector_correlation import correlation_grid
from surveysim.atmosphere.turbulence_fit import TRACKS_RAD
from surveysim.paper.figures.cleaning import ATMOSPHERE_HZ, frequencies, halfway_out
from surveysim.paper.measured_survey import MeasuredSurvey, fit_survey
from surveysim.paper.measurement import Measurement, measure
from surveysim.reduction.cleaned_block import CleanedBlock, reduce_block
from surveysim.reduction.cleaning_pipelines import CleaningPipeline, apply_pipeline
from surveysim.reduction.figure_of_merit import TARGETS, figures_of_merit
from surveysim.reduction.setup import prepare
from surveysim.runtime.engine import Engine, ordered_map
from surveysim.scene.scene import Scene
from surveysim.survey.scores import PEAK
from surveysim.timestreams.observation import Stopwatch
from surveysim.timestreams.response import write_sky_signal
from surveysim.timestreams.simulation import observation_path

AVERAGE, CLEANINGS = "average", ("average", "planar", "quadratic", "pca")
# Changes of a scene whose observations are cleaned with all of them.
SETTINGS = {
    "cleaning.algorithm": AVERAGE,
    "cleaning.compare": [[name] for name in CLEANINGS[1:]],
    "cleaning.sigma_cut": 3.0,  # paper, section 4.4
    "score.noise_only_sets": [],
    "score.mask_separation_f_lambda": None,
    "score.reference": None,
}
TRUSTED = "trusted"  # a wind without flag
MAP_RAD = radians(465 / 60)  # motion of the layer in a scan of 15 s at 31 arcmin/s: side of the smallest model maps
Values = Mapping[str, np.ndarray]  # (n_obs,) by name


@dataclass(frozen=True)
class ObservationValues:
    """Measurements of one observation, and what cleaning does to its noise and to signals.

    Attributes
    ----------
    template_ratios
        PSD of the five higher-order templates over that of the zeroth order, geometric means over the frequencies of
        the atmosphere and over all.
    modes
        Modes that adaptive PCA removes, mean over kept scans.
    merits : (n_cleaning, n_target)
        Figures of merit (`surveysim.reduction.figure_of_merit`).
    flux_removed : (n_cleaning,)
        Fraction of the flux of a faint point source that cleaning removes.
    """

    measurement: Measurement
    template_ratios: tuple[float, float]
    modes: float
    merits: np.ndarray
    flux_removed: np.ndarray


@dataclass(frozen=True)
class ValuesJob:
    """Job of a worker: simulate and measure an observation of a scene with `SETTINGS`, given its number."""

    scene: Scene

    def __call__(self, observation: int) -> ObservationValues:
        """Simulate and measure an observation."""
        setup = prepare(self.scene)
        _, pointing = observation_path(setup.observing, observation)
        (block,) = setup.observing.blocks
        part = reduce_block(setup, observation, pointing, block, delays_s_rad=None, watch=Stopwatch())
        merits, flux_removed = _signal_and_noise(part)
        of = dict(zip(CLEANINGS, part.cleaned, strict=True))
        return ObservationValues(
            measurement=measure(setup, part.streams.timestreams(), observation),
            template_ratios=template_ratios(part, of["quadratic"]),
            modes=float(of["pca"].removed[of["pca"].kept].mean()),
            merits=merits,
            flux_removed=flux_removed,
        )


def template_ratios(part: CleanedBlock, quadratic: Cleaned) -> tuple[float, float]:
    """Compare the PSDs of higher-order templates with the zeroth order, as in `ObservationValues`; NaN without scans.

    At a place halfway from the centre of the array to its edge, as in figure 11.
    """
    if not quadratic.kept.any():
        return np.nan, np.nan
    plane, scans = part.streams.focal_plane, part.setup.observing.scans
    streams = template_streams(
        part.data_mk,
        part.streams.scan_bounds,
        plane,
        responsivity=quadratic.responsivity,
        exponents=QUADRATIC,
        place_rad=halfway_out(plane),
    )
    frequency = frequencies(part.setup)
    psd = hann_psd(streams, scans.n_scans, quadratic.kept, scans.sample_rate_hz)[:, 1 : 1 + len(frequency)]
    ratio = np.log(psd[1:].mean(axis=0) / psd[0])
    return float(np.exp(ratio[frequency <= ATMOSPHERE_HZ].mean())), float(np.exp(ratio.mean()))


def _signal_and_noise(part: CleanedBlock) -> tuple[np.ndarray, np.ndarray]:
    """Compute figures of merit (n_cleaning, n_target) and removed flux (n_cleaning,) of one observation.

    The transfer functions are those of the observation, because the modes that PCA removes depend on the weather.
    """
    analysis = part.setup.analysis
    patch, region = analysis.region.patch, analysis.region
    noise = [_noise_map(part, place) for place in range(len(CLEANINGS))]
    hits = [item[1][patch, patch] for item in noise]
    signals = np.array([signal_maps(part, sky) for sky in analysis.signal_skies_mk[[0, -1]]])[..., patch, patch]
    everywhere = np.ones_like(region.taper)
    power = np.apply_along_axis(
        lambda flat: region.ring_noise(flat.reshape(everywhere.shape), everywhere), -1, signals.reshape(2, 4, 2, -1)
    )
    passed = np.divide(power[:, :, 1], power[:, :, 0], out=np.zeros_like(power[:, :, 0]), where=power[:, :, 0] > 0)
    merits = figures_of_merit(analysis, passed.swapaxes(0, 1), noise)
    source = signals[-1] / np.maximum(hits, 1)[:, None]
    return merits, np.array([_removed(*states) for states in source])


def _removed(without: np.ndarray, cleaned: np.ndarray) -> float:
    """Fraction of a source's flux that cleaning removes at the peaks of its map; NaN without a peak."""
    peak = without > PEAK * without.max()
    return 1 - float(cleaned[peak].sum() / without[peak].sum()) if peak.any() else np.nan


def _noise_map(part: CleanedBlock, place: int) -> tuple[np.ndarray, np.ndarray]:
    """Bin the cleaned streams of a pipeline; sums and hits (n_y, n_x)."""
    geometry, item = part.setup.analysis.geometry, part.cleaned[place]
    total, hits = np.zeros(geometry.n_y * geometry.n_x), np.zeros(geometry.n_y * geometry.n_x, np.int64)
    bin_samples(item.data_mk, part.index[place], part.streams.scan_bounds, item.kept, total, hits)
    return total.reshape(geometry.n_y, geometry.n_x), hits.reshape(geometry.n_y, geometry.n_x)


def signal_maps(part: CleanedBlock, sky_mk: np.ndarray) -> np.ndarray:
    """Bin a signal, and the difference that it makes to the cleaned streams: sums (n_cleaning, 2, n_y, n_x).

    Scans in which the signal changes the number of removed modes are left out: the difference is noise there.
    """
    signal = np.empty_like(part.data_mk)
    write_sky_signal(part.setup, part.pointing, sky_mk, signal)
    passed = part.streams.filled(part.streams.response.output(sky_mk, signal))
    geometry, bounds = part.setup.analysis.geometry, part.streams.scan_bounds
    maps = np.zeros((len(part.pipelines), 2, geometry.n_y, geometry.n_x))
    for planes, pipeline, index, base in zip(maps, part.pipelines, part.index, part.cleaned, strict=True):
        both = _cleaned_with(part, pipeline, base, passed)
        same = base.kept.copy()
        same[base.kept] = both.kept & (both.removed == base.removed[base.kept])
        for plane, data in zip(planes, (signal, both.data_mk - base.data_mk), strict=True):
            bin_samples(data, index, bounds, same, plane.reshape(-1), None)
    return maps


def _cleaned_with(part: CleanedBlock, pipeline: CleaningPipeline, base: Cleaned, added_mk: np.ndarray) -> Cleaned:
    """Clean the kept scans of a block with a signal added; fits begin with the responsivities without it."""
    kept = base.kept
    return apply_pipeline(
        part.setup.scene.cleaning,
        pipeline,
        part.data_mk + added_mk,
        scan_bounds=part.streams.scan_bounds[kept],
        focal_plane=part.streams.focal_plane,
        auxiliary=replace(
            part.auxiliary, delays_s_rad=part.auxiliary.delays_s_rad[kept], first_guess=base.responsivity[kept]
        ),
        sample_rate_hz=part.setup.observing.scans.sample_rate_hz,
    )


def survey_values(
    scene: Scene, model: Scene, engine: Engine, progress: Callable[[], None] = lambda: None
) -> dict[str, np.ndarray]:
    """Simulate the observations of a scene, and return their values (n_obs,) by name.

    Parameters
    ----------
    scene
        Scene with `SETTINGS`.
    model
        Scene of the layer that the fits of B2 and spectral index assume.
    engine
        Workers.
    progress
        Called after each observation.

    Raises
    ------
    SceneError
        For a scene that can't be run.
    """
    items = []
    for item in ordered_map(ValuesJob(scene), range(scene.observations), engine):
        items.append(item)
        progress()
    unscored = prepare(model.model_copy(update={"score": None}))
    names = (scene.name,) * len(items)
    return _table(fit_survey(unscored, names, tuple(item.measurement for item in items)), items)


def _table(survey: MeasuredSurvey, items: list[ObservationValues]) -> dict[str, np.ndarray]:
    i_b, _ = survey.fixed
    fits = [fit.best[0] if fit is not None else None for fit in survey.fits]
    values = {
        "observation": np.array([item.measurement.observation for item in items]),
        "drawn_b2": survey.b2_drawn,
        "fitted_b2": survey.b2_fitted,
        "lowest_layer_b2": survey.b2_at((i_b, 0)),
        "highest_layer_b2": survey.b2_at((i_b, len(survey.grid.height_m) - 1)),
        **_limited_b2(survey),
        "fitted_index": np.array([np.nan if best is None else survey.grid.index[best] for best in fits]),
        "wind": np.array([item.measurement.wind.flag or TRUSTED for item in items]),
        "raw_mk2": np.array([item.measurement.raw_mk2 for item in items]),
        "template_ratio_low": np.array([item.template_ratios[0] for item in items]),
        "template_ratio_all": np.array([item.template_ratios[1] for item in items]),
        "pca_modes": np.array([item.modes for item in items]),
    }
    for c, name in enumerate(CLEANINGS):
        values |= {
            f"merit_{target}_{name}": np.array([x.merits[c, t] for x in items]) for t, target in enumerate(TARGETS)
        }
        values[f"flux_removed_{name}"] = np.array([item.flux_removed[c] for item in items])
    return values


def _limited_b2(survey: MeasuredSurvey) -> dict[str, np.ndarray]:
    """B2 at the lowest and highest layer over that of the fixed height, fitted with model maps of `MAP_RAD`.

    The model's outer scale is an angle, the same at all heights. It changes the level of C alone, which gives B2.
    """
    air, i_h, heights = survey.setup.scene.atmosphere, survey.fixed[1], survey.grid.height_m
    level = {}
    for place in (0, i_h, -1):
        grid = correlation_grid(
            survey.bins.theta_rad,
            index=(air.spectral_index,),
            height_m=(heights[place],),
            aperture_m=air.illuminated_aperture_m,
            outer_scale_m=MAP_RAD * heights[place],
            track_rad=TRACKS_RAD,
            lowest_rad=min(float(item.elevation_rad.min()) for item in survey.measurements),
        )
        theory = replace(survey, grid=grid).theory
        level[place] = np.array([np.log(theory(k)[0, 0]) @ survey.bins.count for k in range(len(survey.measurements))])
    fall = {place: (level[i_h] - level[place]) / survey.bins.count.sum() for place in (0, -1)}
    return {"limited_lowest_ratio": np.exp(fall[0]), "limited_highest_ratio": np.exp(fall[-1])}
