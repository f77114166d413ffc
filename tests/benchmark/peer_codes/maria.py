"""maria, without the network: its tables of weather and emission are written here."""

import logging
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from peer_codes.observation import (
    APERTURE_M,
    ELEVATION_RAD,
    LATITUDE_DEG,
    LONGITUDE_DEG,
    MAP_PIXEL_RAD,
    PSD_MK2_HZ,
    SITE_M,
    START,
    Observation,
    Streams,
)


def write_tables(folder: Path) -> None:
    """Write plain tables of weather and emission in place of those that maria fetches."""
    import h5py

    pressure_hpa = np.array([1000.0, 900, 800, 700, 600, 500, 400, 300, 200, 100])
    height_m = -8000 * np.log(pressure_hpa / 1013)
    profile = {
        "temperature": 288 - 0.0065 * np.minimum(height_m, 11e3),
        "humidity": 20 + 0 * height_m,
        "geopotential": 9.80665 * height_m,
        "wind_north": 9 + 0 * height_m,
        "wind_east": 0.1 + 0 * height_m,
        "wind_speed": 9 + 0 * height_m,
        "divergence": 1e-5 + 0 * height_m,
    }
    weather, spectra = (folder / f"atmosphere/{name}/mauna_kea.h5" for name in ("weather/era5", "spectra/am/v3"))
    for path in (weather, spectra):
        path.parent.mkdir(parents=True, exist_ok=True)
    with h5py.File(weather, "w") as file:
        file["quantile_levels"], file["pressure_levels"] = np.array([0.0, 0.5, 1.0]), pressure_hpa
        file["year_day_side"], file["day_hour_side"] = np.array([0.0, 367.0]), np.array([0.0, 25.0])
        file["year_day_edge_index"] = file["day_hour_edge_index"] = np.array([0, 0])
        for name, values in profile.items():
            part = file.create_group(f"data/{name}")
            part["normalized_quantiles"] = np.tile(values, (1, 1, 3, 1))
            part["scale"], part["mean"] = 1.0, 0.0
    sides = {
        "side_altitude_m": np.array([0.0, 6000.0]),
        "side_base_temperature_K": np.array([240.0, 270.0, 300.0]),
        "side_zenith_pwv_mm": np.linspace(0.0, 20.0, 21),
        "side_elevation_deg": np.linspace(10.0, 90.0, 17),
        "side_nu_Hz": np.linspace(100e9, 200e9, 201),
    }
    _, base_k, water_mm, elevation_deg, _ = np.meshgrid(*sides.values(), indexing="ij", sparse=True)
    opacity = np.broadcast_to(0.02 * water_mm / np.sin(np.radians(elevation_deg)), [len(v) for v in sides.values()])
    with h5py.File(spectra, "w") as file:
        for name, values in sides.items():
            file[name] = values
        file["opacity_nepers"], file["excess_path_m"] = opacity, 0 * opacity
        file["rayleigh_jeans_temperature_K"] = base_k * (1 - np.exp(-opacity))


def eight_layers(seen: Observation) -> Callable[[], Any]:
    """Simulate all layers."""
    return _maria(seen, lambda layers: layers)


def one_layer(seen: Observation) -> Callable[[], Any]:
    """Simulate the layer from 500 to 1000 m alone, with the variance of all."""
    return _maria(
        seen,
        lambda layers: layers.iloc[1:2].reset_index(drop=True).assign(pwv_rms=np.sqrt((layers.pwv_rms**2).sum())),
    )


def _maria(seen: Observation, select: Callable[[Any], Any]) -> Callable[[], Any]:
    """Simulate some layers, remove the first mode of all streams, bin a map."""
    from astropy.coordinates import AltAz, EarthLocation, SkyCoord
    from astropy.time import Time
    from astropy.utils import iers
    from maria import Simulation
    from maria.array import Array
    from maria.atmosphere import atmosphere
    from maria.band import Band
    from maria.instrument import Instrument
    from maria.mappers import BinMapper
    from maria.plan import Plan
    from maria.site import Site

    iers.conf.auto_download = False
    logging.getLogger("maria").setLevel(logging.ERROR)
    write_tables(Path(os.environ["MARIA_CACHE_DIR"]))
    band = Band(center=143e9, width=21e9, NET_RJ=1e-3 * np.sqrt(PSD_MK2_HZ / 2), knee=0)
    xi, eta = np.degrees(seen.offsets_rad.T)
    array = Array.from_kwargs(name="camera", bands=[band], primary_size=APERTURE_M, xi=xi, eta=eta)
    site = Site(region="mauna_kea", latitude=LATITUDE_DEG, longitude=LONGITUDE_DEG, altitude=SITE_M)
    place = EarthLocation.from_geodetic(lon=LONGITUDE_DEG, lat=LATITUDE_DEG, height=SITE_M)
    start = Time(START.removesuffix("+00:00"))
    frame = AltAz(obstime=start, location=place)
    field = SkyCoord(az=0, alt=ELEVATION_RAD, unit="rad", frame=frame).icrs
    time_s = start.unix + np.arange(seen.shape[1]) / seen.rate_hz
    x, y = seen.boresight_rad.T
    plan = Plan(time_s, field.ra.rad + x / np.cos(field.dec.rad), field.dec.rad + y, frame="ra/dec", site=site)
    instrument = Instrument([array])
    layers = atmosphere.generate_layers
    quiet = {"disable_progress_bars": True}

    def run() -> Any:
        with patch.object(atmosphere, "generate_layers", lambda **arguments: select(layers(**arguments))):
            simulation = Simulation(
                instrument, plan, site, atmosphere="2d", atmosphere_kwargs=quiet, progress_bars=False
            )
            (drawn,) = simulation.run()
        mapper = BinMapper(
            [drawn],
            resolution=np.degrees(MAP_PIXEL_RAD),
            stokes="I",
            tod_preprocessing={"remove_modes": {"modes_to_remove": 1}},
            progress_bars=False,
        )
        mapper.run()
        return drawn, mapper.tods[0]

    return run


def streams(result: Any) -> Streams:
    """Streams that maria simulated and mapped."""
    before, after = (1e3 * np.asarray(item.to("K_RJ").signal) for item in result)
    return before, after
