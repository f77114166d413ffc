"""The sky of a scene in words: one sentence for each of its parts."""

from collections.abc import Iterator, Mapping
from pathlib import PurePath
from typing import Any

from surveysim.report.html.components import UK2
from surveysim.runtime.numbers import number, plural, short

Values = Mapping[str, Any]


def sky_words(sky: Values) -> Iterator[str]:
    """Describe the sky from the content of scene.json."""
    yield from _random(sky)
    for item in sky.get("maps", ()):
        yield f"The map {PurePath(item['map_file']).name}, through the beam of the camera."
    for item in sky.get("catalogues", ()):
        yield f"Sources of the catalogue {PurePath(item['catalogue_file']).name}, of flux densities {_law(item)}."
    for item in sky.get("clusters", ()):
        yield f"A cluster with the profile {item['profile']!r} and y0 = {number(item['y0'], 3)}."
    if sky["point_sources"]:
        yield f"{_sources(sky['point_sources'])}."


def _random(sky: Values) -> Iterator[str]:
    parts = []
    if sky["cmb_band_power_ukcmb2"] is not None:
        parts.append(f"a CMB of flat band power, {short(sky['cmb_band_power_ukcmb2'])} {UK2}")
    if sky.get("spectrum"):
        parts.append(f"a Gaussian sky of the spectrum {PurePath(sky['spectrum']).name}")
    if parts:
        where = f"on the sphere up to l = {sky['curved_lmax']}" if sky["curved_lmax"] else "on the plane"
        words = " and ".join(parts)
        yield f"{words[0].upper()}{words[1:]}, {where}."


def _law(item: Values) -> str:
    index = item["spectral_index"]
    found = "of the table" if index is None else short(index)
    return f"at {short(item['flux_frequency_hz'] / 1e9)} GHz (spectral index {found})"


def _sources(sources: list[Values]) -> str:
    peaks = [f"{short(source['peak_mk'])} mK" for source in sources if source["peak_mk"] is not None]
    fluxes = [f"{short(1e3 * source['flux_jy'])} mJy {_law(source)}" for source in sources if source["peak_mk"] is None]
    brightness = "; ".join([*([", ".join(peaks) + " (Rayleigh-Jeans)"] if peaks else []), *fluxes])
    return f"{plural(len(sources), 'point source')} of {brightness}"
