"""A resolved scene in words: field, camera, atmosphere, noise, cleaning, map and score."""

import math
from collections.abc import Callable, Iterator, Mapping
from fractions import Fraction
from functools import partial
from itertools import chain
from pathlib import PurePath
from typing import Any

from surveysim.reduction.signal_sims import carriers
from surveysim.report.html.components import Block, Terms
from surveysim.report.html.quantities import arcmin, arcsec, deg, degrees, hours, listed, percent, span
from surveysim.report.html.readout import DESCRIPTIONS
from surveysim.report.html.response import response_terms
from surveysim.report.html.scan_words import scan_words
from surveysim.report.html.sky_words import sky_words
from surveysim.runtime.numbers import joined, number, plural, short
from surveysim.scene.sites import OWN, site_title
from surveysim.scene.units import b2_unit
from surveysim.timestreams.component import COMPONENTS, StreamComponent

CLEANINGS = {
    "none": "removal of each scan's mean",
    "average": "average subtraction",
    "planar": "planar subtraction",
    "quadratic": "quadratic subtraction",
    "polynomial": "polynomial subtraction",
    "wind": "average subtraction shifted along the wind",
    "pca": "adaptive PCA",
    "local": "subtraction of the mean of neighbours",
    "spectral": "subtraction of the signal common to the bands",
    "highpass": "a high-pass filter",
    "notch": "notch filters",
    "time_polynomial": "subtraction of a polynomial in time",
}
COHERENCES = {
    "field": "as far as the fields of overlapping beams are coherent (hypothesis of Sayers et al. 2010)",
    "hbt": "as far as light from common sources is coherent (Hanbury Brown and Twiss)",
    "intensity": "as the square of the coherence of the fields of overlapping beams",
    "none": "not at all",
}
SIMULATED = {"uncorrelated": "the same noise without correlations", "white": "white noise"}

_MEV_J = 1.602176634e-22

Values = Mapping[str, Any]


def scene_terms(scene: Values, n_det: int) -> tuple[tuple[str, str], ...]:
    """Return terms with their descriptions, from the content of scene.json, for the stages that the scene has."""
    components = [item for item in COMPONENTS if scene.get(item.name)]
    tell: dict[str, Callable[[], Iterator[str]]] = {
        "Field": lambda: _field(scene),
        "Observations": lambda: _observations(scene),
        "Camera": lambda: chain(
            _camera(scene["instrument"], n_det, "the last element" if scene.get("optics") else "window"), _bands(scene)
        ),
        **({"Optics": lambda: _optics(scene["optics"])} if scene.get("optics") else {}),
        **{item.title: partial(_component, item, scene[item.name]) for item in components},
        **response_terms(scene),
        "Cleaning": lambda: _cleaning(scene["cleaning"]),
        "Map": lambda: _map(scene),
        "Score": lambda: _score(scene["score"], scene["observations"]),
        "Numerics": lambda: _numerics(scene["numerics"]),
    }
    if scene["score"] is None:
        del tell["Score"]
    return tuple((term, " ".join(words())) for term, words in tell.items())


def what_was_simulated(scene: Values, summary: Mapping[str, Any], n_det: int) -> tuple[Block, ...]:
    """Return the scene in words, and each omitted stage with its reason."""
    left_out = summary.get("left_out") or dict.fromkeys(summary.get("stages_left_out", ()), "no such section")
    terms = Terms(scene_terms(scene, n_det))
    return (terms, Terms(tuple(left_out.items()), "Stages left out")) if left_out else (terms,)


def cleaning_words(steps: list[str]) -> str:
    """Return the steps of a cleaning pipeline in words."""
    return ", then ".join(CLEANINGS.get(step, step) for step in steps)


def _field(scene: Values) -> Iterator[str]:
    field = scene["field"]
    yield f"Centred on right ascension {hours(field['ra_rad'])}, declination {degrees(field['dec_rad'])} (J2000)."
    if fixed := scene["fixed_pointing"]:
        elevation, parallactic = deg(fixed["elevation_rad"]), deg(fixed["parallactic_angle_rad"])
        yield f"The telescope stays at an elevation of {elevation}° and a parallactic angle of {parallactic}°."
    if plan := scene["schedule"]:
        yield (
            f"Observed from latitude {deg(plan['latitude_rad'])}°, longitude {deg(plan['longitude_rad'])}°,"
            f" {short(plan['height_m'])} m high, in {plural(plan['nights'], 'night')} from {plan['first_night']},"
            f" within {short(math.degrees(plan['max_hour_angle_rad']) / 15)} h of transit and above"
            f" {deg(plan['min_elevation_rad'])}°."
        )


def _observations(scene: Values) -> Iterator[str]:
    scan = scene["scan"]
    yield f"{plural(scene['observations'], 'observation')} of {scan_words(scan)}"
    if scan["dither_rad"]:
        yield f"Each observation is offset at random within {arcmin(scan['dither_rad'])}."
    yield f"Detectors are sampled at {short(scan['sample_rate_hz'])} Hz."


def _layout(layout: Values, f_lambda_rad: float) -> str:
    """Describe the lattice of a layout or a wafer."""
    shape, side = layout.get("shape", "hexagon"), layout.get("side")
    extent = f"a {shape} of {side} by {side}" if side is not None else f"{layout['rings']} rings"
    if layout["field_of_view_rad"] is not None:
        extent = f"a field of view of {arcmin(layout['field_of_view_rad'])}"
    lattice = "on a square lattice" if shape == "square" else "hexagonal"
    pitch = f"{short(layout['pitch_f_lambda'])} (f/#)λ"
    dead = f", {len(layout['dead'])} of them dead" if layout["dead"] else ""
    rest = "the others" if layout["dead"] else "them"
    lost = f", {percent(layout['yield_fraction'])} of {rest} working" if layout.get("yield_fraction", 1) < 1 else ""
    width = arcsec(layout["pitch_f_lambda"] * f_lambda_rad)
    return f"Positions are {lattice} over {extent}, neighbours {pitch} apart ({width}){dead}{lost}."


def _camera(camera: Values, n_det: int, behind: str) -> Iterator[str]:
    yield f"{plural(n_det, 'detector')} {band_of(camera)},"
    yield f"with a beam of {arcsec(camera['beam_fwhm_rad'])} (FWHM); (f/#)λ is {arcsec(camera['f_lambda_rad'])}."
    if camera["layout"]:
        yield _layout(camera["layout"], camera["f_lambda_rad"])
    for index, wafer in enumerate(camera.get("wafers", ())):
        place = f"({arcmin(wafer['offset_x_rad'])}, {arcmin(wafer['offset_y_rad'])})"
        turned = f", turned by {deg(wafer['rotation_rad'])}°" if wafer["rotation_rad"] else ""
        yield f"Wafer {index} is at {place}{turned}. {_layout(wafer, camera['f_lambda_rad'])}"
    if camera["positions"]:
        chosen = f", its band {camera['table_band']}" if camera.get("table_band") else ""
        yield f"Detectors come from the table {PurePath(camera['positions']).name}{chosen}."
    yield f"Responsivities scatter by {percent(camera['responsivity_scatter'])}."
    if camera["camera_rotation_range_rad"]:
        yield f"The camera angle varies within {deg(camera['camera_rotation_range_rad'])}° between observations."
    if camera["horn_f_lambda"] is not None:
        mode = " with the HE11 mode" if camera["illumination"] == "he11" else ""
        yield f"Horns{mode} are {short(camera['horn_f_lambda'])} (f/#)λ wide."
    elif camera["illumination"] not in (None, "uniform", "gaussian"):
        yield f"Pixels illuminate the stop as in the table {PurePath(camera['illumination']).name}."
    if camera["edge_taper_db"] is not None:
        yield f"Pixels illuminate the stop with an edge taper of {short(camera['edge_taper_db'])} dB."
    if camera["efficiency"] is not None:
        yield f"The efficiency from {behind} to detector is {percent(camera['efficiency'])}."
    if camera["polarizations"] is not None:
        yield f"Detectors absorb {plural(camera['polarizations'], 'polarization')}."


def _bands(scene: Values) -> Iterator[str]:
    if scene.get("other_bands"):
        others = joined(scene["other_bands"])
        yield f"The camera has other bands, {others}, which see the same layer and sky with noise of their own."


def band_of(camera: Values) -> str:
    """Name the band of a camera: its frequency and width, or its table."""
    if camera["passband"]:
        return f"in the band {PurePath(camera['passband']).name}"
    width = f", {percent(camera['bandwidth'])} wide" if camera["bandwidth"] else ""
    return f"at {short(camera['frequency_hz'] / 1e9)} GHz{width}"


def _component(item: StreamComponent, section: Values) -> Iterator[str]:
    """Describe a component by its parameters, or by its one sentence."""
    if item.name in _COMPONENTS:
        yield from _COMPONENTS[item.name](section)
    else:
        yield f"{item.sentence[0].upper()}{item.sentence[1:]}."


def _atmosphere(air: Values) -> Iterator[str]:
    index = Fraction(air["spectral_index"]).limit_denominator(1000)
    yield f"{_layers(air)}, seen through an aperture of"
    yield f"{short(air['illuminated_aperture_m'])} m, with the spectrum B2 α^(-{index})."
    for layer in air["layers"]:
        factor, turn = short(layer["wind_factor"]), short(math.degrees(layer["wind_turn_rad"]))
        yield f"{layer['name']}: {percent(layer['share'])} of B2, {short(layer['height_m'])} m above the telescope,"
        yield f"with {factor} times the speed of the drawn wind in m/s, turned by {turn} deg."
    if air["outer_scale_m"] is not None:
        yield f"Its outer scale is {short(air['outer_scale_m'])} m."
    if air["site"]:
        place = "the site of the scene" if air["site"] == OWN else site_title(air["site"])
        yield f"Water and water fluctuations are those of {place}."
    unit = b2_unit(air["spectral_index"])
    if air["b2"]:
        levels = ", ".join(short(100 * level) for level in air["b2_probabilities"])
        yield f"B2 is drawn for each observation, with the quantiles {listed(air['b2'])} {unit} at {levels} %."
    else:
        yield "B2 of each observation follows from its water and water fluctuation."
    wind = air["wind_median_rad_s"]
    yield f"Winds have a median of {arcmin(wind)}/s ({number(wind * air['layer_height_m'])} m/s at"
    yield f"{short(air['layer_height_m'])} m), a scatter of {short(air['wind_log_scatter'])} in the logarithm"
    yield "and all directions."
    if air["wind_drift"]:
        yield f"They change within an observation, on a time scale of {short(air['wind_drift']['time_scale_s'])} s."
    if air["wind_b2_exponent"]:
        yield f"Their median is proportional to B2^({short(air['wind_b2_exponent'])})."
    if air["weather_table"] is not None:
        yield f"The table {PurePath(air['weather_table']).name} replaces distributions of its columns."
    if air["correlation_time_s"] is not None:
        yield f"Weather drifts: observations correlate by exp(-lag / {short(air['correlation_time_s'] / 3600)} h)."


def _layers(air: Values) -> str:
    """Name the layers of the atmosphere, without their spectrum."""
    seconds = air["decorrelation_time_s"]
    kind = "frozen" if seconds is None else f"slowly changing ({short(seconds)} s)"
    if air["profile"]:
        height = short(air["water_scale_height_m"])
        return f"{kind.capitalize()} layers of an {air['profile']} profile of scale height {height} m"
    if air["layers"]:
        return f"{len(air['layers'])} {kind} layers"
    return f"One {kind} layer {short(air['layer_height_m'])} m above the telescope"


def _excess(excess: Values) -> Iterator[str]:
    variances = excess["variance_mk2"]
    yield f"Low-frequency noise of {span(variances)} mK2 below {short(excess['band_limit_hz'])} Hz"
    if len(variances) > 1:
        yield f"(growing with B2 from {span(excess['b2'])}),"
    yield f"spectrum f^(-{short(excess['spectral_index'])}). Neighbours share it {COHERENCES[excess['coherence']]}."


def _optics(optics: Values) -> Iterator[str]:
    if optics["aperture_m"] is not None:
        hidden = optics["central_obscuration_m"]
        less = f", obscured over {short(hidden)} m in its centre" if hidden else ""
        yield f"An aperture of {short(optics['aperture_m'])} m{less}."
    if optics["sky_k"] is not None:
        yield f"A sky of {short(optics['sky_k'])} K."
    for element in optics["elements"]:
        losses = [_loss(element, kind) for kind in ("transmission", "emissivity") if element[kind] is not None]
        name = element["name"][:1].upper() + element["name"][1:]
        yield f"{name} at {short(element['temperature_k'])} K, {joined(losses)}."
    if optics["stop"] is not None:
        yield f"A stop at {short(optics['stop']['temperature_k'])} K."


def _loss(element: Values, kind: str) -> str:
    value = element[kind]
    return f"{kind} {PurePath(value).name if isinstance(value, str) else percent(value)}"


def _photon(photon: Values) -> Iterator[str]:
    if photon["psd_mk2_hz"] is None:
        if load := photon["load"]:
            sky = "the site's water" if load["sky_k"] is None else f"a sky of {short(load['sky_k'])} K"
            yield f"From the load of {sky} and warm optics of {short(load['optics_k'])} K."
        else:
            yield "From the load of the optics."
        of = "its bunching part" if photon["coherence"] == "hbt" else "the noise of the load through the beam"
        yield f"Neighbours share {of} {COHERENCES[photon['coherence']]}."
    else:
        share, how = photon["coherent_fraction"], photon["coherence"]
        shared = f"{percent(share)} of it common to neighbours {COHERENCES[how]}"
        if how == "hbt":
            bose, stop = photon["bose_fraction"], photon["stop_fraction"]
            shared = f"{percent(bose)} of it from bunching, {percent(share)} of the load through the beam"
            shared += f" and {percent(stop)} from the stop;" if stop else ";"
            share += stop or 0.0
            shared += f" neighbours share the bunching of that part {COHERENCES[how]}"
            share *= bose
        yield f"White, {short(photon['psd_mk2_hz'])} mK2 / Hz,"
        yield f"{shared if share > 0 and how != 'none' else 'independent between detectors'}."


def _detector(detector: Values) -> Iterator[str]:
    if detector["psd_mk2_hz"] is not None:
        yield f"White, {short(detector['psd_mk2_hz'])} mK2 / Hz,"
    elif bolometer := detector["bolometer"]:
        yield f"Thermal noise of a link of {short(1e12 * bolometer['conductance_w_k'])} pW / K from"
        yield f"{short(1e3 * bolometer['critical_temperature_k'])} to {short(1e3 * bolometer['bath_temperature_k'])} mK"
        yield f"and an amplifier of {number(bolometer['amplifier_nep_w_rthz'], 2)} W / Hz(1/2),"
    elif kid := detector["kid"]:
        yield f"Recombination noise of the load at a gap of {short(kid['gap_j'] / _MEV_J)} meV"
        yield f"and an amplifier of {number(kid['amplifier_nep_w_rthz'], 2)} W / Hz(1/2),"
    elif detector["nep_w_rthz"] is not None:
        yield f"White, a noise-equivalent power of {number(detector['nep_w_rthz'], 2)} W / Hz(1/2),"
    else:
        yield "White, of each detector as in the table of detectors,"
    yield "independent between detectors."


_COMPONENTS: dict[str, Callable[[Any], Iterator[str]]] = {
    "atmosphere": _atmosphere,
    "excess": _excess,
    "sky": sky_words,
    "photon": _photon,
    "detector": _detector,
    **DESCRIPTIONS,
}

_RESPONSIVITIES = {
    "scan": "Responsivities are fitted to each scan.",
    "observation": "Responsivities are fitted to all scans of an observation together.",
    "survey": "Responsivities are known with a fixed error of {error:.3g} rms.",
    "known": "Responsivities are known.",
}


def _cleaning(cleaning: Values) -> Iterator[str]:
    words = cleaning_words(cleaning["algorithm"])
    yield f"{words[0].upper()}{words[1:]}."
    if cleaning["compare"]:
        yield f"Compared with {joined([cleaning_words(steps) for steps in cleaning['compare']])}."
    from mapmaker.cleaning import TEMPLATE_CLEANINGS

    named = {name for steps in (cleaning["algorithm"], *cleaning["compare"]) for name in steps}
    if not named.isdisjoint(TEMPLATE_CLEANINGS):
        yield _RESPONSIVITIES[cleaning["responsivities"]].format(error=cleaning["calibration_error"])
    yield f"Templates are iterated to {number(cleaning['tolerance'], 1)}, at most {cleaning['max_iterations']} times."
    if "pca" in named:
        yield f"PCA removes modes by {_CRITERIA[cleaning['pca_criterion']]}."
    for key, unit in _DETAILS.items():
        if cleaning[key] is not None:
            name = key.removesuffix("_hz").replace("_", " ").capitalize().replace("Pca", "PCA")
            yield f"{name}: {f'{_values(cleaning[key])} {unit}'.strip()}."


_CRITERIA = {
    "sigma_cut": "outliers of their logarithms",
    "modes": "number",
    "variance": "their share of the variance",
    "marchenko_pastur": "the largest eigenvalue of white noise",
}
_DETAILS = {
    "sigma_cut": "sigma",
    "pca_modes": "",
    "pca_variance": "",
    "neighbour_radius": "closest separations",
    "order": "",
    "regions": "",
    "highpass_frequency_hz": "Hz",
    "highpass_order": "",
    "notch_frequencies_hz": "Hz",
    "notch_widths_hz": "Hz",
    "time_order": "",
}


def _values(value: Any) -> str:
    return joined([short(item) for item in value]) if isinstance(value, list | tuple) else short(value)


def _map(scene: Values) -> Iterator[str]:
    yield f"Pixels of {arcsec(scene['map']['pixel_rad'])}, binned, in a tangent plane."
    if scene["map"]["healpix_nside"]:
        yield f"Also as HEALPix maps at nside {scene['map']['healpix_nside']}."


def _numerics(numerics: Values) -> Iterator[str]:
    step = numerics["screen_step"]
    lattice = "the default spacing" if step == 1 else f"{short(step)} times the default spacing"
    yield f"Time-streams are {numerics['precision']};"
    yield f"interpolation in the layer is {numerics['interpolation']}, on a lattice of {lattice}."


def _score(score: Values, observations: int) -> Iterator[str]:
    yield "σ(A), the uncertainty of the amplitude A of a flat CMB band power,"
    yield f"from multipoles {score['ell_min']} to {score['ell_max']} in bins of {score['ell_bin']},"
    edges = percent(score["taper_fraction"])
    yield f"over {arcmin(score['size_rad'])} square, with cosine edges on {edges} of each side."
    yield f"The noise is measured by {score['jackknives']} co-adds with random signs, the transfer function by"
    through = int(carriers(score["signal_sims"]["observations"], observations).sum())
    yield f"{score['signal_sims']['skies']} skies through {plural(through, 'observation')}."
    others = [SIMULATED[name] for name in score["noise_only_sets"]]
    if score["mask_separation_f_lambda"]:
        others.append(f"an array masked to {short(score['mask_separation_f_lambda'])} (f/#)λ")
    if others:
        yield f"Also scored: {joined(others)}."
