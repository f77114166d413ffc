"""Observation that surveysim and its peers simulate."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

ARCMIN = np.radians(1 / 60)
ELEVATION_RAD = np.radians(55.0)
PSD_MK2_HZ, INDEX, B2, HEIGHT_M, APERTURE_M = 5.0, 11 / 3, 280.0, 1000.0, 8.0
MAP_PIXEL_RAD = ARCMIN / 3
LATITUDE_DEG, LONGITUDE_DEG, SITE_M = 19.8225, -155.4761, 4070.0
START = "2024-01-01T06:00:00+00:00"
SCENE = f"""
title = "One observation for comparison with peers"
seed = 1
observations = 1000
[field]
ra = "08h49m12s"
dec = "+44d50m24s"
[fixed_pointing]
elevation = "55 deg"
parallactic_angle = "0 deg"
[instrument]
frequency = "143 GHz"
beam_fwhm = "60 arcsec"
f_lambda = "57.142857 arcsec"
responsivity_scatter = 0.0
camera_rotation_range = "0 deg"
[instrument.layout]
rings = 6
pitch_f_lambda = 0.7
dead = [1, 8, 22, 24, 45, 62, 74, 76, 81, 93, 110, 121]
[scan]
speed = "4 arcmin / s"
scans = 20
duration = "15 s"
turnaround = "10 s"
step = "2.4 arcmin"
dither = "0 arcmin"
sample_rate = "10 Hz"
[atmosphere]
spectral_index = "11/3"
layer_height = "{HEIGHT_M} m"
illuminated_aperture = "{APERTURE_M} m"
b2_probabilities = [0.5]
b2 = "[{B2}] mK2 rad(-5/3)"
wind_median = "31 arcmin / s"
wind_log_scatter = 0.0
[detector]
psd = "{PSD_MK2_HZ} mK2 / Hz"
[cleaning]
algorithm = "average"
tolerance = 1e-8
max_iterations = 100
[map]
pixel = "20 arcsec"
"""

Streams = tuple[np.ndarray, np.ndarray]  # before and after subtraction (n_det, n_samp) [mK]


@dataclass(frozen=True)
class Observation:
    """Observation that all codes simulate.

    Attributes
    ----------
    setup
        The scene as surveysim prepares it.
    offsets_rad : (n_det, 2)
        Detectors in the tangent plane.
    boresight_rad, layer_rad : (n_samp, 2)
        Boresight in the tangent plane, and in the layer from the start of its scan.
    bounds : (n_scan, 2)
        Samples of the scans.
    """

    setup: Any
    rate_hz: float
    offsets_rad: np.ndarray
    boresight_rad: np.ndarray
    layer_rad: np.ndarray
    bounds: np.ndarray

    @property
    def shape(self) -> tuple[int, int]:
        """Numbers of detectors and samples."""
        return len(self.offsets_rad), len(self.boresight_rad)

    @property
    def white_mk(self) -> np.float32:
        """Deviation of the white noise of a sample."""
        return np.float32(np.sqrt(PSD_MK2_HZ * self.rate_hz / 2))


def prepare_observation(rate_hz: float, folder: Path) -> Observation:
    """Prepare the observation at a sample rate; its scene goes to a folder."""
    from mapmaker.geometry import sky_offsets
    from mapmaker.timestreams import scan_bounds
    from surveysim.reduction.setup import prepare
    from surveysim.scene.scene import load_scene
    from surveysim.telescope.pointing import sky_vector
    from surveysim.timestreams.observed_block import observation_weather
    from surveysim.timestreams.simulation import observation_path

    path = folder / "peers.toml"
    path.write_text(SCENE)
    setup = prepare(load_scene(path, {"scan.sample_rate": f"{rate_hz} Hz"}))
    _, pointing = observation_path(setup.observing, 0)
    wind = sky_vector(pointing.scan_parallactic_rad[0], *observation_weather(setup, 0).wind_rad_s)
    bounds = scan_bounds(pointing.scan)
    since_start = (np.arange(len(pointing.scan)) - bounds[pointing.scan, 0]) / rate_hz
    return Observation(
        setup=setup,
        rate_hz=rate_hz,
        offsets_rad=np.stack(sky_offsets(setup.camera.focal_plane, pointing.scan_array_angle_rad[:1]), axis=-1)[0],
        boresight_rad=np.stack([pointing.xi_rad, pointing.eta_rad], axis=-1),
        layer_rad=(pointing.velocity_rad_s[pointing.scan] - np.array(wind)) * since_start[:, None],
        bounds=bounds,
    )
