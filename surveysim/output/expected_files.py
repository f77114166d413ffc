"""Results of runs and forecasts: the files that they may write, and a hash of everything that they depend on."""

from hashlib import sha256

from surveysim.output.record import Results
from surveysim.output.scene_copy import bands_files, scene_files
from surveysim.reduction.setup import Setup
from surveysim.scene.bands import MultiBandScene, bands_hash
from surveysim.scene.scene import Scene, scene_hash, survey_hash
from surveysim.survey.bright_sky import FILE as BRIGHT_SKY
from surveysim.survey.checkpoint import NAME as CHECKPOINT
from surveysim.survey.checkpoint import WEIGHTS

COMMON = ("summary.json", "scene.json", "report.html")
SCORES = "scores.npz"
SPECTRA = ("spectra.ecsv", "spectra_windows.ecsv", "spectra.sacc")
_TABLES = (
    "observations",
    "timestream_psd",
    "scores",
    "metrics",
    "map_psd",
    "alternatives",
    "split_spectra",
    "sky_transfer",
    "sky_fluxes",
    "nulls",
    "load",
    "nep",
    "sensitivity",
)
_FIGURES = (
    "track",
    "timestream_psd",
    "map",
    "map_psd",
    "transfer_function",
    "sky",
    "cumulative_sensitivity",
    "weights",
    "spectra",
    "weather",
    "run_time",
)


def of_run(setup: Setup, figures: bool, timestreams: bool) -> Results:
    """Return the results of a run of a scene."""
    scene = setup.scene
    names = [CHECKPOINT, *_run_names(scene), *_map_names(setup), *(_figure_names() if figures else ())]
    names += beside_checkpoint(scene)
    if timestreams:
        names += [f"timestreams/{number:04d}.h5" for number in range(scene.observations)]
    return Results("run", scene.name, scene_hash(scene), tuple(names), scene_files(scene), extends=survey_hash(scene))


def of_point(setup: Setup, keep_all: bool) -> Results:
    """Return the results of a point of a sweep: those of a run, with maps and figures if all are kept."""
    scene = setup.scene
    names = (*_run_names(scene), *((*_map_names(setup), *_figure_names()) if keep_all else ()))
    return Results("run", scene.name, scene_hash(scene), names, scene_files(scene), extends=survey_hash(scene))


def _run_names(scene: Scene) -> tuple[str, ...]:
    tables = (*_TABLES, *_metric_tables(scene))
    return (*COMMON, SCORES, *SPECTRA, *(f"tables/{name}.ecsv" for name in tables))


def _metric_tables(scene: Scene) -> tuple[str, ...]:
    if scene.score is None:
        return ()
    from surveysim.metrics.registry import metric_table_names

    return tuple(metric_table_names(scene.score))


def _map_names(setup: Setup) -> tuple[str, ...]:
    endings = ("", "_healpix") if setup.scene.map.healpix_nside else ("",)
    maps = tuple(f"maps/{name}{ending}.fits" for name in setup.analysis.data_set_names for ending in endings)
    skies = setup.analysis.transfer_function_names if setup.analysis.own_sky is not None else ()
    return (*maps, *(f"maps/sky_{name}.fits" for name in skies))


def _figure_names() -> tuple[str, ...]:
    return tuple(f"figures/{name}.png" for name in _FIGURES)


def band_directory(name: str) -> str:
    """Directory of the results of one band, within that of the camera."""
    return f"bands/{name}"


OF_BANDS = ("summary.json", "report.html", "bands.ecsv")


def of_bands(scenes: MultiBandScene, command: str) -> Results:
    """Return the results of a camera of several bands beside the directories of the bands."""
    names = OF_BANDS if command == "run" else ("bands.ecsv",)
    extends = sha256(" ".join(map(survey_hash, scenes.bands.values())).encode()).hexdigest() if command == "run" else ""
    return Results(command, scenes.name, bands_hash(scenes), names, bands_files(scenes), extends=extends)


def beside_checkpoint(scene: Scene) -> list[str]:
    """Files that maps other than binned ones keep beside the checkpoint."""
    if scene.map.maker == "iterative":
        return [BRIGHT_SKY]
    return [f"{WEIGHTS}/{number:04d}.npz" for number in range(scene.observations * scene.map.solved)]


def of_forecast(scene: Scene) -> Results:
    """Return the results of a forecast of a scene."""
    return Results("forecast", scene.name, scene_hash(scene), ("forecast.ecsv",), scene_files(scene))
