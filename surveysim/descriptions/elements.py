"""Optical elements of bolojax as elements of a scene: their absorption, reflection, spillover and scattering."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from surveysim.descriptions.reader import KELVIN, POSITIVE, SHARE, Allowed, Field, Fields, Reader, fields_of
from surveysim.descriptions.scene_text import Row, Table, measured
from surveysim.runtime.errors import InputError
from surveysim.scene.units import LIGHT_M_S, shown

VACUUM_OHM, VACUUM_H_M = 376.730313668, 4e-7 * math.pi
TYPES = ("element", "mirror", "dielectric", "aperture_stop")
_METRE = Allowed("m", "m")


@dataclass(frozen=True)
class Band:
    """Lowest, central and highest frequency of a channel [Hz], and its number in the camera from 0."""

    low_hz: float
    centre_hz: float
    high_hz: float
    place: int


def optics_tables(reader: Reader, skipped: tuple[str, ...], band: Band) -> list[Table]:
    """Tables of the stop and of the elements, from the sky to the detector.

    Raises
    ------
    InputError
        For an element that is no mapping, without a temperature, or with losses that can't be read.
    """
    default = reader.fields("instrument.optics_config.default", default={})
    stop, tables, side = [], [], "sky"
    for name, field in _elements(reader):
        if name in skipped:
            reader.note(field)
            continue
        fields = default | fields_of(field)
        kind = reader.text(fields, "type") or "element"
        if kind not in TYPES:
            raise InputError(f"{fields['type'].key}: found {shown(kind)}; one of {', '.join(TYPES)} is expected")
        if kind == "aperture_stop":
            side = "detector"
            stop.append(Table("[optics.stop]", (_temperature(reader, fields, name, "temperature"),)))
            continue
        tables += _element(reader, fields, name, side, band)
    return [*stop[:1], *tables]


def _elements(reader: Reader) -> Iterator[tuple[str, Field]]:
    key = "instrument.optics_config.elements"
    found = reader.fields("instrument.optics_config").get("elements", Field(key, []))
    items = found.value if isinstance(found.value, list) else [found.value]
    for place, item in enumerate(items):
        yield from fields_of(Field(f"{key}.{place}", item)).items()


def _temperature(reader: Reader, fields: Fields, name: str, key: str) -> Row:
    kelvin = reader.number(fields, key, KELVIN)
    if kelvin is None:
        raise InputError(f"optics_config: element {shown(name)}: temperature: missing; a temperature is expected")
    return Row("temperature", measured(kelvin, "K"), f"{name}.{key}")


def _element(reader: Reader, fields: Fields, name: str, side: str, band: Band) -> list[Table]:
    """Table of an element, and one for each loss that ends at another temperature."""
    own = _temperature(reader, fields, name, "temperature")
    absorbed, of_absorbed = _absorption(reader, fields, band)
    passed, emitted, extra = 1 - absorbed, absorbed, []
    for key, (lost, of_lost) in {
        "spillover": (_share(reader, fields, "spillover", band), "spillover"),
        "scatter": _scattering(reader, fields, band),
    }.items():
        warm = own
        if reader.number(fields, f"{key}_temp", KELVIN) is not None:
            warm = _temperature(reader, fields, name, f"{key}_temp")
        if lost == 0:
            continue
        if warm.value == own.value:
            passed, emitted, of_absorbed = passed * (1 - lost), emitted + lost, f"{of_absorbed}, {of_lost}"
        else:
            extra.append(_table(f"{name}, {key}", warm, side, [Row("emissivity", _number(lost), of_lost)]))
    reflected = _share(reader, fields, "reflection", band)
    passed *= 1 - reflected
    rows = [
        Row("transmission", _number(passed), "with its reflection" if reflected else "rest of its emissivity"),
        Row("emissivity", _number(min(emitted, 1 - passed)), of_absorbed),
    ]
    return [_table(name, own, side, rows), *extra]


def _table(name: str, temperature: Row, side: str, rows: list[Row]) -> Table:
    place = Row("side", side, "before the aperture stop" if side == "sky" else "behind the aperture stop")
    return Table("[[optics.elements]]", (Row("name", name, ""), temperature, place, *rows))


def _number(value: float) -> float:
    return float(f"{value:.10g}")


def _absorption(reader: Reader, fields: Fields, band: Band) -> tuple[float, str]:
    """Absorption at the centre of the band and the fields that it is from."""
    conductivity = reader.number(fields, "conductivity", Allowed("S / m", "S / m"))
    if conductivity is not None:  # 4 R_s / Z_0 with R_s = sqrt(pi nu mu_0 / sigma)
        resistance = math.sqrt(math.pi * band.centre_hz * VACUUM_H_M / conductivity)
        return min(4 * resistance / VACUUM_OHM, 1.0), "conductivity, at the band's centre"
    thickness = reader.number(fields, "thickness", _METRE)
    index = reader.number(fields, "index", POSITIVE)
    loss = reader.number(fields, "loss_tangent", SHARE)
    if thickness is not None and index is not None and loss is not None:
        depth = 2 * math.pi * index * loss * thickness * band.centre_hz / LIGHT_M_S
        return 1 - math.exp(-depth), "thickness, index and loss_tangent, at the band's centre"
    return _share(reader, fields, "absorption", band), "absorption"


def _scattering(reader: Reader, fields: Fields, band: Band) -> tuple[float, str]:
    rough = reader.number(fields, "surface_rough", Allowed("m", "m", above=False))
    if rough is not None:  # Ruze
        phase = 4 * math.pi * rough * band.centre_hz / LIGHT_M_S
        return 1 - math.exp(-(phase**2)), "surface_rough, at the band's centre"
    return _share(reader, fields, "scatter_frac", band), "scatter_frac"


def _share(reader: Reader, fields: Fields, name: str, band: Band) -> float:
    """Number from 0 to 1, or mean of a file over the band; 0 where it is absent."""
    found = fields.get(name)
    if found is None or found.file is None:
        return reader.number(fields, name, SHARE, band.place) or 0.0
    frequency, values = (np.array(column) for column in reader.table(found, band.place))
    if found.value["var_type"] == "pdf":
        mean = float(frequency @ values / values.sum()) if values.sum() > 0 else math.nan
    else:
        inside = np.linspace(band.low_hz, band.high_hz, 200)
        mean = float(np.interp(inside, 1e9 * frequency, values).mean())
    if not 0 <= mean <= 1:
        raise InputError(f"{found.key}: found a mean of {mean:g}; a number from 0 to 1 is expected")
    return mean
