"""Descriptions of bolojax as scenes.

A description has an instrument: a site, optics from the sky to the detector, and cameras with channels. A scene is one
channel. The formulas are those of bolojax, after Hill et al. 2018 (BoloCalc, Proc. SPIE 10708).
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from surveysim.descriptions.detectors import Channel, detector_table
from surveysim.descriptions.elements import Band, optics_tables
from surveysim.descriptions.reader import POSITIVE, SHARE, Allowed, Field, Reader, fields_of
from surveysim.descriptions.scene_text import Row, Table, measured, scene_text
from surveysim.descriptions.survey import View, layer_aperture_m, survey_tables
from surveysim.runtime.errors import InputError
from surveysim.scene.similar_names import did_you_mean
from surveysim.scene.sites import site_names
from surveysim.scene.units import LIGHT_M_S, shown

SITE_NAMES = {"atacama": "alma", "pole": "south_pole"} | {name: name for name in site_names()}
_SURVEY = "the scene has a survey of its own"
_NOISE = "a scene has the noise of its own elements"
_DEFAULTS = ("instrument.channel_default.", "instrument.camera_config.default.", "instrument.optics_config.default.")
# Fields that are known and have no place in a scene, and why.
REASONS = {
    "universe": "the sky is that of the site's water and the CMB",
    "sim_config": "samples and steps of the other program",
    "instrument.obs_time": _SURVEY,
    "instrument.sky_fraction": _SURVEY,
    "instrument.obs_effic": _SURVEY,
    "instrument.NET": "a factor on the other program's result",
    "instrument.sky_temp": "the load of the sky follows from the site's water",
    "instrument.custom_atm_file": "the opacity is the site's",
    "instrument.readout": _NOISE,
    "boresite_elevation": "all pixels see the sky at instrument.elevation",
    "pixel_elevation": "all pixels see the sky at instrument.elevation",
    "optical_coupling": "signal has the efficiency of the load",
    "beam_model": "correlations follow from photon.coherence",
    "num_wafer_per_optics_tube": "one wafer is simulated",
    "num_optics_tube": "one wafer is simulated",
    "Tc_fraction": "Tc is used",
    "errors": "a distribution is its central value",
    "bounds": "a distribution is its central value",
    "free": "nothing is fitted",
    "absorption": "it follows from other fields",
    "scatter_frac": "it follows from surface_rough",
    "psat": "G is used",
    "psat_factor": "G or psat is used",
    "read_frac": "squid_nei and bolo_resistance are used",
    "squid_nei": "bolo_resistance is missing",
    "bolo_resistance": "squid_nei is missing",
    "response_factor": "squid_nei or bolo_resistance is missing",
    "Flink": "it follows from carrier_index",
    "nyquist_inductance": "it has no place in a scene",
}


@dataclass(frozen=True)
class Imported:
    """Scene of a description.

    Parameters
    ----------
    text
        Text of the scene file.
    files
        Texts of the tables that it names, by file name.
    unused
        A line for each field that the scene does not have, with the reason.
    """

    text: str
    files: Mapping[str, str]
    unused: tuple[str, ...]


def import_bolojax(path: Path, *, name: str, channel: str | None, aperture_m: float) -> Imported:
    """Make a scene of one channel of a description.

    Parameters
    ----------
    path
        YAML file.
    name
        Name of the scene, with which its tables' names begin.
    channel
        ``CAMERA/CHANNEL``; None for the only one.
    aperture_m
        Diameter of the telescope's illuminated aperture.

    Raises
    ------
    InputError
        One line for what can't be read or used: file, key, value found, values expected.
    """
    try:
        reader = Reader(path)
        channels = _channels(reader)
        chosen = _chosen(channels, channel)
        files, before, after = _tables(reader, chosen, name=name, aperture_m=aperture_m)
        detector = detector_table(reader, chosen, scene_text((), [*before, *after]), files)
        unused = tuple(_reasoned(reader, chosen))
    except InputError as error:
        raise InputError("\n".join(f"{path}: {line}" for line in str(error).splitlines())) from None
    comments = [
        f"{chosen.name} of {path.name}, a description of bolojax.",
        'Comments name the fields that values are from. "assumed" says that the description has no value.',
        *(f"Not used: {line}" for line in unused),
    ]
    return Imported(scene_text(comments, [*before, detector, *after]), files, unused)


# ---------------------------------------------------------------- channels


def _channels(reader: Reader) -> dict[str, Channel]:
    channel_default = reader.fields("instrument.channel_default", default={})
    camera_default = reader.fields("instrument.camera_config.default", default={})
    found = {}
    for camera, field in reader.fields("instrument.camera_config.elements").items():
        own = fields_of(field)
        config = fields_of(own.get("chan_config", Field(f"{field.key}.chan_config", "")))
        shared = channel_default | fields_of(config["default"]) if "default" in config else channel_default
        channels = fields_of(config.get("elements", Field(f"{field.key}.chan_config.elements", "")))
        for place, (channel, values) in enumerate(channels.items()):
            merged = camera_default | own
            found[f"{camera}/{channel}"] = Channel(f"{camera}/{channel}", shared | fields_of(values), merged, place)
    return found


def _chosen(channels: Mapping[str, Channel], name: str | None) -> Channel:
    if not channels:
        raise InputError("instrument.camera_config.elements: found no channel; a camera with chan_config is expected")
    names = ", ".join(channels)
    if name is None:
        if len(channels) > 1:
            raise InputError(f"found {len(channels)} channels; --channel with one of {names} is expected")
        return next(iter(channels.values()))
    if name not in channels:
        expected = did_you_mean(name, tuple(channels)) or f"one of {names} is expected"
        raise InputError(f"--channel: found {shown(name)}; {expected}")
    return channels[name]


# ---------------------------------------------------------------- fields without a place


def _reasoned(reader: Reader, chosen: Channel) -> list[str]:
    """Lines on the fields that were not read: one for each other channel, none for defaults that others replace."""
    cameras = "instrument.camera_config.elements."
    lines: dict[str, None] = {}
    for key in reader.unused():
        if key.startswith(cameras) and (other := _other_channel(key.removeprefix(cameras), chosen.name)):
            lines[f"{other}: another channel"] = None
        elif not (key.startswith(_DEFAULTS) and key.split(".")[-1] in reader.names):
            lines[_reason(key)] = None
    return list(lines)


def _reason(key: str) -> str:
    """Line with the key, or the part of it that has a reason, and the reason."""
    for part, why in REASONS.items():
        before, found, _ = f".{key}.".partition(f".{part}.")
        if found:
            return f"{before}.{part}: {why}".strip(".")
    return f"{key}: unknown"


def _other_channel(key: str, chosen: str) -> str:
    """Name of the camera or channel that a field belongs to; empty for the chosen one."""
    camera, _, rest = key.partition(".")
    if camera != chosen.partition("/")[0]:
        return camera
    of_channels = "chan_config.elements."
    channel = rest.removeprefix(of_channels).partition(".")[0] if rest.startswith(of_channels) else ""
    return f"{camera}/{channel}" if channel and f"{camera}/{channel}" != chosen else ""


# ---------------------------------------------------------------- scene


@dataclass(frozen=True)
class Pixels:
    """Pixels of a wafer: their number, distance [(f/#)lambda], edge taper [dB], and widths on the sky."""

    number: int
    pitch_f_lambda: float
    edge_taper_db: float
    view: View


def _tables(
    reader: Reader, chosen: Channel, *, name: str, aperture_m: float
) -> tuple[dict[str, str], list[Table], list[Table]]:
    """Files of the scene, and its tables before and after [detector]."""
    files, band_rows, band, largest = _band(reader, chosen, name)
    pixels = _pixels(reader, chosen, band, aperture_m)
    skipped = _names(chosen.camera.get("skip_optical_elements"), reader)
    first_look = Row("observations", 4, "assumed: a first look")
    title = Row("title", f"{chosen.name} of {reader.path.name}, one wafer", "")
    scan, *others = survey_tables(pixels.view)
    head = [
        Table("", (title, Row("seed", 20260101, "any number"), first_look)),
        Table("[field]", (Row("ra", "00h00m00s", "assumed"), Row("dec", "-45d00m00s", "assumed"))),
        Table("[fixed_pointing]", _pointing(reader)),
        Table("[instrument]", (*band_rows, *_instrument(reader, chosen, pixels, largest))),
        Table("[instrument.layout]", _layout(reader, chosen, pixels)),
        scan,
        Table("[atmosphere]", _atmosphere(reader, pixels.view)),
        Table("[optics]", (Row("aperture", f"{aperture_m:g} m", "option --aperture"),)),
        *optics_tables(reader, skipped, band),
        Table("[photon]", (Row("coherence", "hbt", "correlation of photon bunching"),)),
    ]
    return files, head, others


def _pixels(reader: Reader, chosen: Channel, band: Band, aperture_m: float) -> Pixels:
    fields, place = chosen.fields, chosen.place
    pixel_m = reader.require(fields, "pixel_size", Allowed("m", "mm"), place)
    f_lambda_m = reader.require(chosen.camera, "f_number", POSITIVE) * LIGHT_M_S / band.centre_hz
    waist = reader.require(fields, "waist_factor", POSITIVE, place)
    # Power beyond the edge of the stop: exp(-(pi^2 / 2) (pixel_size / (waist_factor f lambda))^2).
    taper_db = 10 / math.log(10) * math.pi**2 / 2 * (pixel_m / (waist * f_lambda_m)) ** 2
    number = max(1, round(reader.require(fields, "num_det_per_water", POSITIVE, place) / 2))
    pitch, f_lambda_rad = pixel_m / f_lambda_m, LIGHT_M_S / band.centre_hz / aperture_m
    # The beam of a tapered aperture is about (1.02 + 0.0135 T) lambda / D wide (Goldsmith 1998).
    beam_rad = (1.02 + 0.0135 * taper_db) * f_lambda_rad
    field_rad = 2 * pitch * f_lambda_rad * math.sqrt(math.sqrt(0.75) * number / math.pi)
    return Pixels(number, pitch, taper_db, View(beam_rad, field_rad, aperture_m))


def _instrument(reader: Reader, chosen: Channel, pixels: Pixels, largest: float) -> tuple[Row, ...]:
    efficiency = reader.number(chosen.fields, "det_eff", SHARE, chosen.place)
    origin = "det_eff" if efficiency is not None else "assumed: no det_eff"
    efficiency = largest * (1.0 if efficiency is None else efficiency)
    return (
        Row("efficiency", float(f"{efficiency:.6g}"), origin),
        Row("polarizations", 2, "two detectors of a pixel are one, their sum"),
        Row("edge_taper", f"{pixels.edge_taper_db:.6g} dB", "pixel_size, waist_factor, f_number"),
        Row("responsivity_scatter", 0.05, "assumed"),
        Row("camera_rotation_range", "60 deg", "assumed: from one observation to the next"),
    )


def _band(reader: Reader, chosen: Channel, name: str) -> tuple[dict[str, str], tuple[Row, ...], Band, float]:
    """File of the passband, rows of the band, its edges, and its largest transmission."""
    fields, place = chosen.fields, chosen.place
    centre = reader.require(fields, "band_center", Allowed("Hz", "GHz"), place)
    width = reader.require(fields, "fractional_bandwidth", Allowed(high=0.999), place)
    band = Band(centre * (1 - width / 2), centre, centre * (1 + width / 2), place)
    response = fields.get("band_response")
    if response is None or response.file is None:
        largest = reader.number(fields, "band_response", Allowed(high=1.0), place)
        rows = (
            Row("frequency", measured(centre / 1e9, "GHz"), "band_center"),
            Row("bandwidth", float(f"{width:.6g}"), "fractional_bandwidth"),
        )
        return {}, rows, band, 1.0 if largest is None else largest
    frequency, transmission = reader.table(response, place)
    largest = max(transmission)
    if not (0 < largest <= 1 and min(transmission) >= 0):
        raise InputError(f"{response.key}: found a transmission of {largest:g}; numbers from 0 to 1 are expected")
    lines = [
        "# %ECSV 1.0",
        "# ---",
        "# datatype:",
        "# - {name: frequency, unit: GHz, datatype: float64}",
        "# - {name: transmission, datatype: float64}",
        "frequency transmission",
        *(f"{one!r} {other / largest!r}" for one, other in zip(frequency, transmission, strict=True)),
    ]
    file = f"{name}_band.ecsv"
    band = Band(1e9 * frequency[0], centre, 1e9 * frequency[-1], place)
    return {file: "\n".join(lines) + "\n"}, (Row("passband", file, f"band_response: {response.file}"),), band, largest


def _pointing(reader: Reader) -> tuple[Row, ...]:
    degrees = reader.number(reader.fields("instrument"), "elevation", Allowed("deg", "deg", high=90.0))
    row = Row("elevation", "50 deg", "assumed")
    if degrees is not None:
        row = Row("elevation", f"{degrees:g} deg", "instrument.elevation")
    return row, Row("parallactic_angle", "0 deg", "assumed")


def _layout(reader: Reader, chosen: Channel, pixels: Pixels) -> tuple[Row, ...]:
    """Rows of the layout: rings where they hold the pixels exactly, else a round field of view."""
    origin = f"num_det_per_water: {pixels.number} pixels of two detectors"
    rings = round((math.sqrt(12 * pixels.number - 3) - 3) / 6)
    extent = Row("rings", rings, origin)
    if 3 * rings * (rings + 1) + 1 != pixels.number or rings > 60:
        extent = Row("field_of_view", f"{math.degrees(pixels.view.field_rad) * 60:.5g} arcmin", origin)
    rows = extent, Row("pitch_f_lambda", float(f"{pixels.pitch_f_lambda:.6g}"), "pixel_size, f_number")
    working = reader.number(chosen.fields, "Yield", Allowed(high=1.0), chosen.place)
    return rows if working is None else (*rows, Row("yield", working, "Yield"))


def _atmosphere(reader: Reader, view: View) -> tuple[Row, ...]:
    instrument = reader.fields("instrument")
    found = reader.text(instrument, "site")
    if (found or "").lower() not in SITE_NAMES:
        expected = did_you_mean(found or "", tuple(SITE_NAMES)) or f"one of {', '.join(SITE_NAMES)} is expected"
        raise InputError(f"instrument.site: found {shown(found)}; {expected}")
    rows = [
        Row("site", SITE_NAMES[(found or "").lower()], "instrument.site: water, its opacity, wind, turbulence"),
        Row("spectral_index", "11/3", "Kolmogorov turbulence"),
        Row("illuminated_aperture", measured(layer_aperture_m(view), "m"), "width of a pixel's beam in the layer"),
    ]
    water = reader.number(instrument, "pwv", Allowed("mm", "mm"))
    if water is not None:
        rows += [Row("pwv", [f"{water:g} mm"], "instrument.pwv, constant"), Row("pwv_probabilities", [0.5], "")]
    return tuple(rows)


def _names(field: Field | None, reader: Reader) -> tuple[str, ...]:
    """Names in a list of texts."""
    if field is None or field.absent:
        return ()
    reader.note(field)
    if not isinstance(field.value, list):
        raise InputError(f"{field.key}: found {shown(field.value)}; a list of names is expected")
    return tuple(map(str, field.value))
