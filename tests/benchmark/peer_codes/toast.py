"""TOAST: a chain of its operators, with default settings otherwise."""

import datetime
import itertools
from collections.abc import Callable

import numpy as np
from peer_codes.observation import (
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


def toast(seen: Observation) -> Callable[[], Streams]:
    """Simulate back-and-forth scans at constant elevation, subtract the common mode, bin a map."""
    import toast
    import toast.ops as ops
    from astropy import units as u
    from astropy.table import QTable
    from astropy.utils import iers
    from toast.instrument import Focalplane, GroundSite, Telescope
    from toast.instrument_coords import xieta_to_quat
    from toast.schedule import GroundScan, GroundSchedule

    iers.conf.auto_download = False
    n_det, n_samp = seen.shape
    one = np.ones(n_det)
    detectors = QTable(
        {
            "name": [f"D{number}" for number in range(n_det)],
            "quat": xieta_to_quat(*seen.offsets_rad.T, 0 * one),
            "gamma": 0 * one * u.rad,
            "pol_leakage": 0 * one,
            "fwhm": one * u.arcmin,
            "bandcenter": 143 * one * u.GHz,
            "bandwidth": 21 * one * u.GHz,
            "psd_net": 1e-3 * np.sqrt(PSD_MK2_HZ / 2) * one * u.K * u.s**0.5,
            "psd_fmin": 1e-5 * one * u.Hz,
            "psd_fknee": 1e-5 * one * u.Hz,
            "psd_alpha": one,
        }
    )
    site = GroundSite("mauna_kea", LATITUDE_DEG * u.deg, LONGITUDE_DEG * u.deg, SITE_M * u.m)
    telescope = Telescope("camera", focalplane=Focalplane(detectors, sample_rate=seen.rate_hz * u.Hz), site=site)
    start = datetime.datetime.fromisoformat(START)
    half = np.ptp(seen.boresight_rad[:, 0]) / 2 / np.cos(ELEVATION_RAD) * u.rad
    scan = GroundScan(
        name="field",
        start=start,
        stop=start + datetime.timedelta(seconds=n_samp / seen.rate_hz),
        az_min=np.pi * u.rad - half,
        az_max=np.pi * u.rad + half,
        el=ELEVATION_RAD * u.rad,
    )
    schedule = GroundSchedule(
        [scan],
        site_name=site.name,
        telescope_name=telescope.name,
        site_lat=LATITUDE_DEG * u.deg,
        site_lon=LONGITUDE_DEG * u.deg,
        site_alt=SITE_M * u.m,
    )
    realizations = itertools.count()

    def run() -> Streams:
        number = next(realizations)
        data = toast.Data(toast.Comm())
        ops.SimGround(
            telescope=telescope,
            schedule=schedule,
            weather="atacama",
            scan_rate_az=4 * u.arcmin / u.s,
            median_weather=True,
            realization=number,
        ).apply(data)
        in_azel = ops.PointingDetectorSimple(boresight="boresight_azel", quats="quats_azel")
        in_radec = ops.PointingDetectorSimple(boresight="boresight_radec", quats="quats_radec")
        ops.DefaultNoiseModel().apply(data)
        ops.SimNoise(realization=number).apply(data)
        ops.SimAtmosphere(detector_pointing=in_azel, realization=number).apply(data)
        before = data.obs[0].detdata["signal"].data.copy()
        ops.CommonModeFilter().apply(data)
        resolution = (np.degrees(MAP_PIXEL_RAD) * u.deg,) * 2
        binner = ops.BinMap(
            pixel_pointing=ops.PixelsWCS(
                detector_pointing=in_radec, projection="TAN", resolution=resolution, dimensions=(), auto_bounds=True
            ),
            stokes_weights=ops.StokesWeights(mode="I", detector_pointing=in_radec),
        )
        ops.BuildPixelDistribution(pixel_dist=binner.pixel_dist, pixel_pointing=binner.pixel_pointing).apply(data)
        ops.CovarianceAndHits(
            pixel_dist=binner.pixel_dist,
            covariance=binner.covariance,
            pixel_pointing=binner.pixel_pointing,
            stokes_weights=binner.stokes_weights,
        ).apply(data)
        binner.apply(data)
        after = data.obs[0].detdata["signal"].data.copy()
        data.clear()
        return 1e3 * before, 1e3 * after

    return run
