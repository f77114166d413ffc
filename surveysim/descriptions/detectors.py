"""Bolometers of bolojax: their conductance and readout noise, at the load of the scene."""

import math
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from surveysim.descriptions.reader import KELVIN, POSITIVE, Allowed, Fields, Reader
from surveysim.descriptions.scene_text import Row, Table, scene_text
from surveysim.reduction.setup import prepare
from surveysim.results.sensitivity import sensitivities
from surveysim.runtime.errors import InputError, SceneError
from surveysim.scene.scene import load_scene
from surveysim.telescope.sensitivity import Sensitivity

# Values of bolojax, where a channel has none.
_PSAT_FACTOR, _READ_FRACTION, _CARRIER_INDEX = 3.0, 0.1, 3.0
_PAIR = 2  # detectors of a pixel


@dataclass(frozen=True)
class Channel:
    """Channel of a camera: its name, its fields, those of the camera, and its number in the camera from 0."""

    name: str
    fields: Fields
    camera: Fields
    place: int


def detector_table(reader: Reader, channel: Channel, scene: str, files: Mapping[str, str]) -> Table:
    """Table [detector.bolometer] of a pixel: two detectors in one.

    Parameters
    ----------
    scene, files
        Text of the scene without detectors, and of the tables that it names.

    Raises
    ------
    InputError
        For fields that can't be read, and lines for keys of the scene that can't be used.
    """
    silent = Table("[detector]", (Row("nep", "0 W / Hz(1/2)", ""),))
    load_w = _sensitivity(scene, silent, files).load_w / _PAIR
    index = reader.number(channel.fields, "carrier_index", Allowed(high=10.0, above=False), channel.place)
    index = _CARRIER_INDEX if index is None else index
    critical = reader.require(channel.fields, "Tc", KELVIN, channel.place)
    bath = reader.require(channel.camera, "bath_temperature", Allowed("K", "K", high=critical))
    carried = critical * (1 - (bath / critical) ** (index + 1)) / (index + 1)  # power over the conductance
    if carried == 0:
        raise InputError(f"bath_temperature: found {bath:g} K; less than Tc, {critical:g} K, is expected")
    conductance, of_conductance = _conductance(reader, channel, load_w, carried)

    def table(amplifier: float, origin: str) -> Table:
        return Table(
            "[detector.bolometer]",
            (
                Row("conductance", f"{_PAIR * conductance * 1e12:.6g} pW / K", f"{of_conductance}; of two detectors"),
                Row("critical_temperature", f"{critical:g} K", "Tc"),
                Row("bath_temperature", f"{bath:g} K", "bath_temperature"),
                Row("exponent", index, "carrier_index"),
                Row("amplifier_nep", f"{amplifier:.5g} W / Hz(1/2)", origin),
            ),
        )

    nep2 = _sensitivity(scene, table(0.0, ""), files).nep2
    return table(*_readout(reader, channel, max(conductance * carried - load_w, 0.0), sum(nep2.values())))


def _conductance(reader: Reader, channel: Channel, load_w: float, carried: float) -> tuple[float, str]:
    """Conductance of a detector [W/K] and the fields that it is from; `carried` is its power over its conductance."""
    given = reader.number(channel.fields, "G", Allowed("W / K", "pW / K"), channel.place)
    if given is not None:
        return given, "G"
    saturation = reader.number(channel.fields, "psat", Allowed("W", "pW"), channel.place)
    if saturation is not None:
        return saturation / carried, "psat"
    factor = reader.number(channel.fields, "psat_factor", POSITIVE, channel.place)
    origin = "assumed" if factor is None else "psat_factor"
    factor = _PSAT_FACTOR if factor is None else factor
    return factor * load_w / carried, f"{origin}: {factor:g} times the load, {1e12 * load_w:.4g} pW"


def _readout(reader: Reader, channel: Channel, bias_w: float, others: float) -> tuple[float, str]:
    """NEP of the readout of a pixel and the fields that it is from; `others` is the squared NEP of all other noise."""
    current = Allowed("A / Hz(1/2)", "pA / Hz(1/2)")
    if {"squid_nei", "bolo_resistance"} <= {name for name, field in channel.fields.items() if not field.absent}:
        nei = reader.require(channel.fields, "squid_nei", current, channel.place)
        ohm = reader.require(channel.fields, "bolo_resistance", Allowed("Ohm", "Ohm"), channel.place)
        response = reader.number(channel.fields, "response_factor", POSITIVE, channel.place) or 1.0
        nep = math.sqrt(_PAIR * ohm * bias_w) * nei / response
        return nep, "squid_nei, bolo_resistance; of two detectors"
    fraction = reader.number(channel.fields, "read_frac", Allowed(above=False), channel.place)
    origin = "assumed" if fraction is None else "read_frac"
    fraction = _READ_FRACTION if fraction is None else fraction
    return math.sqrt(((1 + fraction) ** 2 - 1) * others), f"{origin}: {fraction:g} more noise"


def _sensitivity(scene: str, detector: Table, files: Mapping[str, str]) -> Sensitivity:
    """Sensitivity of a pixel at the median water. Raises InputError with the keys that can't be used."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scene.toml"
        for name, text in files.items():
            (path.parent / name).write_text(text, encoding="utf-8")
        path.write_text(scene + scene_text((), [detector]), encoding="utf-8")
        try:
            return sensitivities(prepare(load_scene(path)))["median"]
        except SceneError as error:
            raise InputError(str(error).replace(f"{path}: ", "")) from None
