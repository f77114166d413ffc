"""Report of `mapmaker clean-and-map`: maps, noise, and what was left out, with reasons."""

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from mapmaker.files import atomic_write
from mapmaker.pipeline.dropped import EXPLANATIONS, FILE, SAMPLES
from mapmaker.pipeline.run import Result
from mapmaker.pipeline.totals import reason_totals
from mapmaker.report.components import Cell, Grid, Page, Picture, Section, Terms, Text, picture
from mapmaker.report.figures import Curve, MapImage, draw_maps, draw_spectra
from mapmaker.report.page import page_bytes

FOOTER = "Written by `mapmaker clean-and-map`. This page is whole: it asks nothing of the network."
_DEEPEST = 4  # the map is shown where its noise is at most this many times the lowest
_MOST_ROWS = 300  # of the table of what was left out
_ARCMIN2 = (180 * 60 / np.pi) ** 2
_SPLITS = {
    "files": "files, divided at random",
    "time": "the earlier and the later half",
    "direction": "scans in opposite directions",
    "detectors": "every second detector",
}


def write_report(path: Path, result: Result) -> None:
    """Write the report page, with its figures inside, atomically."""
    with TemporaryDirectory() as folder:
        page = _page(result, Path(folder))
    with atomic_write(path) as partial:
        partial.write_bytes(page_bytes(page, FOOTER))


def _page(result: Result, folder: Path) -> Page:
    files = [item for item in result.files if item.used]
    share = sum(item.samples_used for item in files) / max(1, sum(item.samples for item in files))
    lead = [f"{len(files)} of {len(result.files)} files are in the map, with {100 * share:.1f} % of their samples."]
    if len(files) < len(result.files):
        lead.append("Files that could not be used are the first rows of the table of data that are left out.")
    sections = (
        Section("map", "Map", (Text(_map_text(result)), *_map_pictures(result, folder))),
        Section("noise", "Noise", _noise_blocks(result, folder)),
        Section("left-out", "Data left out", (_reason_grid(result), _dropped_grid(result))),
        Section("files", "Files", (_file_grid(result),)),
        Section("settings", "Configuration", (Terms(_settings(result), code=True),)),
    )
    return Page("Map of time-streams", f"Map of {len(files)} files", tuple(lead), _key_figures(result, share), sections)


_MAKERS = {
    "binned": "The map is binned from the cleaned time-streams, in mK (Rayleigh-Jeans).",
    "iterative": "The map is made iteratively, in mK (Rayleigh-Jeans): what is significant in it is not cleaned.",
    "destriped": "The map is destriped, in mK (Rayleigh-Jeans): baselines are fitted together with it.",
    "maximum_likelihood": "The map is that of maximum likelihood for the measured noise, in mK (Rayleigh-Jeans).",
}
_LOSS = (
    "It is not corrected for the signal that cleaning removes: a source has less than its flux, and a negative ring."
)


def _map_text(result: Result) -> tuple[str, ...]:
    lines = [_MAKERS[result.config.map.maker], _LOSS, result.maps.solution]
    return tuple(line for line in lines if line)


def _key_figures(result: Result, share: float) -> tuple[tuple[str, str], ...]:
    geometry, spectra = result.maps.map.geometry, result.spectra
    pixel = np.degrees(geometry.pixel_rad) * 3600
    found = [
        ("files in the map", f"{sum(item.used for item in result.files)} of {len(result.files)}"),
        ("samples in the map", f"{100 * share:.1f} %"),
        ("pixel", f"{pixel:.3g} arcsec"),
        ("map", f"{geometry.n_x} × {geometry.n_y} pixels"),
        ("beam", f"{np.degrees(result.fwhm_rad) * 3600:.3g} arcsec"),
    ]
    if spectra is not None:
        found.append(("depth at high ell", f"{_depth(spectra.psd_mk2[0]):.3g} mK arcmin"))
    return tuple(found)


def _depth(psd_mk2: np.ndarray) -> float:
    """Depth [mK arcmin] of the upper half of the bins."""
    return float(np.sqrt(psd_mk2[len(psd_mk2) // 2 :].mean() * _ARCMIN2))


def _map_pictures(result: Result, folder: Path) -> list[Picture]:
    from scipy.ndimage import gaussian_filter

    item, geometry = result.maps.map, result.maps.map.geometry
    weight, sigma = item.weight[0], result.fwhm_rad / np.sqrt(8 * np.log(2)) / geometry.pixel_rad
    # Sums and weights smoothed apart: noisy pixels count for less in their neighbours.
    total, spread = (gaussian_filter(plane, sigma) for plane in (item.weighted_sum[0], weight))
    seen = spread > spread.max() / _DEEPEST**2
    signal = np.where(seen, total / np.where(seen, spread, 1), np.nan)
    noise_map = next((one for one in result.maps.noise if one.weight.any()), None)
    reach = float(np.nanpercentile(np.abs(signal), 99.8)) or 1.0
    hits = np.where(item.hits[0] > 0, item.hits[0], np.nan)
    images = [MapImage(signal, "Signal smoothed with the beam [mK]", "RdBu_r", -reach, reach)]
    if noise_map is not None:
        total, spread = (gaussian_filter(plane[0], sigma) for plane in (noise_map.weighted_sum, noise_map.weight))
        noise = np.where(seen & (spread > 0), total / np.where(spread > 0, spread, 1), np.nan)
        images.append(MapImage(noise, "Noise map smoothed with the beam [mK]", "RdBu_r", -reach, reach))
    draw_maps(folder / "map.png", geometry, images)
    counts = [MapImage(hits, "Samples a pixel", "cividis", 0.0, float(np.nanmax(hits)))]
    if result.maps.map.weight_unit == "mK-2":
        noise = np.where(weight > 0, 1 / np.sqrt(np.where(weight > 0, weight, 1)), np.nan)
        lowest = float(np.nanmin(noise))
        counts.append(MapImage(noise, "Noise a pixel from the weights [mK]", "cividis_r", lowest, _DEEPEST * lowest))
    draw_maps(folder / "hits.png", geometry, counts)
    words = "Pixels are blank where the smoothed noise is more than four times the lowest."
    return [
        picture(
            folder / "map.png",
            "Map and noise map",
            "The map of all data on the left, and its noise map on the right",
            (words, "The noise map is the first of the jackknife maps below; both have one scale of colours."),
        ),
        picture(
            folder / "hits.png",
            "Coverage",
            "Samples a pixel on the left, and noise a pixel on the right",
            ("The noise from the weights does not contain correlated noise.",),
        ),
    ]


def _noise_blocks(result: Result, folder: Path) -> tuple[Text | Picture | Grid, ...]:
    spectra = result.spectra
    if spectra is None:
        return (Text(("There are no halves of the data that overlap enough to measure the noise.",)),)
    errors = spectra.psd_mk2 * np.sqrt(2 / spectra.n_modes)
    curves = [
        Curve(spectra.ell, psd, error, name.replace("_", " "))
        for name, psd, error in zip(spectra.names, spectra.psd_mk2, errors, strict=True)
    ]
    draw_spectra(folder / "noise.png", curves)
    kinds = {split.name: split.kind for split in result.maps.splits}
    rows = tuple(
        (
            Cell(name.replace("_", " ")),
            Cell(_SPLITS[kinds[name]]),
            Cell(f"{_depth(psd):.3g}", _depth(psd)),
            Cell(f"{100 * covered:.0f} %", float(covered)),
        )
        for name, psd, covered in zip(spectra.names, spectra.psd_mk2, spectra.coverage, strict=True)
    )
    return (
        Text(
            (
                "A jackknife map is the difference of the maps of two halves of the data, scaled to the noise of all"
                " data. The sky, which both halves have, cancels.",
                "Divisions by files contain all noise. Those by detectors lack noise that detectors share; those by"
                " direction or time contain what differs between scans.",
            )
        ),
        picture(
            folder / "noise.png",
            "Noise PSDs",
            "Power spectral density of the noise over multipole, a curve for each division of the data",
            ("PSDs are averages over the map with the square of the weight.",),
        ),
        Grid(
            "splits-table",
            "Jackknife maps",
            ("division", "halves", "depth at high ell [mK arcmin]", "weight in both halves"),
            rows,
            ("Pixels that one half lacks are left out: compare depths with care where the last column is small.",),
        ),
    )


def _reason_grid(result: Result) -> Grid:
    rows = tuple(
        (
            Cell(item.reason),
            Cell(item.what),
            Cell("" if item.what == SAMPLES else str(item.count), None if item.what == SAMPLES else item.count),
            Cell(str(item.files), item.files),
            Cell(str(item.samples), item.samples),
            Cell(EXPLANATIONS[item.reason]),
        )
        for item in reason_totals(result.dropped)
    )
    columns = ("reason", "what", "number", "files", "samples", "meaning")
    notes = () if rows else ("Nothing was left out.",)
    return Grid("reasons-table", "Reasons", columns, rows, notes)


def _dropped_grid(result: Result) -> Grid:
    """Files, scans and detectors that were left out; counts of samples are in the file alone."""
    items = sorted((item for item in result.dropped if item.what != SAMPLES), key=lambda item: item.what != FILE)
    rows = tuple(
        (
            Cell(item.file),
            Cell(item.what),
            Cell(str(item.detector)),
            Cell("" if item.scan < 0 else str(item.scan)),
            Cell(item.reason),
            Cell(item.detail),
        )
        for item in items[:_MOST_ROWS]
    )
    notes = ["dropped.ecsv has these rows, and the samples that each detector lost."]
    if len(items) > _MOST_ROWS:
        notes.insert(0, f"{len(items) - _MOST_ROWS} more rows are in the file.")
    columns = ("file", "what", "detector", "scan", "reason", "found")
    return Grid("dropped-table", "Files, scans and detectors", columns, rows, tuple(notes))


def _file_grid(result: Result) -> Grid:
    rows = tuple(
        (
            Cell(item.name),
            Cell("yes" if item.used else "no"),
            Cell(f"{item.n_det_used} of {item.n_det}", item.n_det_used),
            Cell(f"{item.n_scan_used} of {item.n_scan}", item.n_scan_used),
            Cell(f"{100 * item.samples_used / max(1, item.samples):.1f}", item.samples_used / max(1, item.samples)),
            Cell(f"{item.weight**-0.5:.3g}" if item.weight else "", item.weight),
        )
        for item in result.files
    )
    noise = "noise a sample [mK]" if result.maps.map.weight_unit == "mK-2" else "root of 1 / weight"
    columns = ("file", "in the map", "detectors", "scans", "samples [%]", noise)
    return Grid(
        "files-table",
        "Use and noise of each file",
        columns,
        rows,
        ("detectors.ecsv has the noise of each detector in each file.",),
    )


def _settings(result: Result) -> tuple[tuple[str, str], ...]:
    found = []
    for section, content in result.config.model_dump(mode="json").items():
        items = content if isinstance(content, list) else [content]
        for number, item in enumerate(items):
            name = f"{section} {number + 1}" if isinstance(content, list) else section
            found.append((name, ", ".join(f"{key} = {'default' if v is None else v}" for key, v in item.items())))
    return tuple(found)
