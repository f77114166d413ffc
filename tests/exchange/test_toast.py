"""TOAST reads the files that this project writes, and the other way round; the map-makers of both agree."""

import os
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest

import mapmaker as mm
from tests.exchange.streams import ARCSEC, apart, sights, streams

pytestmark = pytest.mark.exchange
ROUNDING_MK = 1e-10  # of maps of 100 mK before the mean is subtracted


@pytest.fixture(scope="module")
def toast():
    """TOAST, alone and with one thread."""
    os.environ |= {"MPI_DISABLE": "1", "TOAST_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "TOAST_LOGLEVEL": "WARNING"}
    import toast
    import toast.io
    import toast.ops

    return toast


def loaded(toast, path):
    """Observation that TOAST reads, with equal noise of all detectors."""
    from astropy import units as u

    data = toast.Data(toast.Comm())
    data.obs.append(toast.io.load_hdf5(str(path), data.comm))
    obs = data.obs[0]
    frequencies, level = np.array([1e-5, 1e-3, 1e3]) * u.Hz, np.ones(3) * u.K**2 * u.s
    obs["noise_model"] = toast.noise.Noise(
        detectors=obs.local_detectors,
        freqs=dict.fromkeys(obs.local_detectors, frequencies),
        psds=dict.fromkeys(obs.local_detectors, level),
    )
    return data


def pointing(toast):
    return toast.ops.PointingDetectorSimple(boresight="boresight_radec", shared_flag_mask=0)


def sights_of(toast, data):
    """Lines of sight (n_det, n_samp, 3) by TOAST's pointing."""
    pointing(toast).apply(data)
    obs = data.obs[0]
    return np.array([toast.qarray.rotate(obs.detdata["quats"][name], [0, 0, 1.0]) for name in obs.local_detectors])


def filtered_and_binned(toast, data, geometry, folder, order):
    """TOAST's map [mK] and hits, on the pixels of a geometry, of scans without polynomials in time up to an order."""
    from astropy import units as u

    pixel = np.degrees(geometry.pixel_rad) * u.deg
    sight = pointing(toast)
    pixels = toast.ops.PixelsWCS(
        detector_pointing=sight,
        projection="TAN",
        center=(np.degrees(geometry.ra0_rad) * u.deg, np.degrees(geometry.dec0_rad) * u.deg),
        resolution=(pixel, pixel),
        dimensions=(geometry.n_x, geometry.n_y),
        auto_bounds=False,
    )
    weights = toast.ops.StokesWeights(mode="I", detector_pointing=sight)
    toast.ops.FilterBin(
        name="made",
        binning=toast.ops.BinMap(pixel_pointing=pixels, stokes_weights=weights, pixel_dist="pixels"),
        poly_filter_order=order,
        poly_filter_view="scanning",
        hwp_angle=None,
        write_map=False,
        write_hits=False,
        write_cov=False,
        write_rcond=False,
        keep_final_products=True,
        output_dir=str(folder),
    ).apply(data)
    # TOAST's reference pixel is one from the middle.
    shift = np.rint(np.array([geometry.n_y, geometry.n_x]) / 2 + 0.5 - pixels.wcs.wcs.crpix[::-1]).astype(int)
    names = ("made_filtered_map", "made_filtered_hits")
    planes = (data[name].data.reshape(geometry.n_y, geometry.n_x) for name in names)
    sky, hits = (np.roll(plane, shift, axis=(0, 1)) for plane in planes)
    return sky * 1e3, hits


def our_map(made, geometry, order):
    bounds, data = made.scan_bounds, made.data_mk.astype(float)
    algorithm = ("time_polynomial", mm.TimePolynomialOptions(order)) if order else ("none", None)
    cleaned = mm.clean(algorithm[0], data, bounds, made.focal_plane, options=algorithm[1])
    return mm.bin_map(geometry, cleaned.data_mk, mm.pixel_indices(geometry, made), bounds, kept=cleaned.kept)


def same_map(ours, sky, hits):
    """Compare signal and hits; returns the number of pixels with hits."""
    np.testing.assert_array_equal(ours.hits.reshape(hits.shape), hits)
    np.testing.assert_allclose(ours.signal_mk.reshape(hits.shape), sky, atol=ROUNDING_MK)
    return (hits > 0).sum()


def test_toast_reads_what_we_write(toast, tmp_path):
    made = streams(flagged=True)
    mm.write_timestreams(tmp_path / "ours.toast.h5", made)
    data = loaded(toast, tmp_path / "ours.toast.h5")
    obs = data.obs[0]
    assert apart(sights_of(toast, data), sights(made)) < 1e-4 * ARCSEC
    np.testing.assert_allclose(obs.detdata["signal"].data * 1e3, made.data_mk, rtol=1e-15)
    np.testing.assert_array_equal(obs.detdata["flags"].data > 0, made.flags)
    np.testing.assert_array_equal([[span.first, span.last] for span in obs.intervals["scanning"]], made.scan_bounds)
    np.testing.assert_array_equal(obs.shared["flags"].data > 0, made.scan < 0)
    assert dict(made.attributes).items() <= dict(obs).items()


def test_polarization_angles_are_those_of_toast(toast, tmp_path):
    """On the sky, TOAST's angle of the x axis of a detector from south through east is our position angle."""
    made = streams()
    mm.write_timestreams(tmp_path / "ours.toast.h5", made)
    data = loaded(toast, tmp_path / "ours.toast.h5")
    pointing(toast).apply(data)
    for row, name in enumerate(data.obs[0].local_detectors):
        axis = toast.qarray.rotate(data.obs[0].detdata["quats"][name], [1.0, 0, 0])
        sight = sights(made)[row]
        east = np.cross([0, 0, 1.0], sight)
        found = np.arctan2((axis * east).sum(1), (axis * np.cross(sight, east)).sum(1))
        expected = made.array_angle_rad + made.focal_plane.angle_rad[row]
        # The meridians of detector and boresight differ by up to the offset times tan(dec).
        offset = np.hypot(made.focal_plane.x_rad[row], made.focal_plane.y_rad[row])
        assert abs(np.sin(found - expected)).max() < 1.5 * offset * np.tan(0.91) + offset**2


@pytest.mark.parametrize("order", [0, 3])
def test_maps_of_our_streams(toast, tmp_path, order):
    made = streams()
    mm.write_timestreams(tmp_path / "ours.toast.h5", made)
    geometry = mm.covering_geometry(
        *mm.mean_direction(made.ra_rad, made.dec_rad), np.radians(20 / 3600), np.radians(0.6)
    )
    theirs = filtered_and_binned(toast, loaded(toast, tmp_path / "ours.toast.h5"), geometry, tmp_path, order)
    assert same_map(our_map(made, geometry, order), *theirs) > 500


@pytest.fixture(scope="module")
def observed(toast, tmp_path_factory):
    """Path of an observation that TOAST simulated: sweeps in azimuth over the Atacama, with noise."""
    from astropy import units as u

    start = datetime(2025, 1, 1, tzinfo=UTC)
    scan = toast.schedule.GroundScan(
        name="sweep", start=start, stop=start + timedelta(seconds=90),
        az_min=40 * u.deg, az_max=43 * u.deg, el=50 * u.deg,
    )  # fmt: skip
    site = toast.GroundSite("atacama", -22.95 * u.deg, -67.78 * u.deg, 5200 * u.m)
    plane = toast.instrument_sim.fake_hexagon_focalplane(
        n_pix=7, width=1 * u.deg, sample_rate=20 * u.Hz, fwhm=10 * u.arcmin, psd_fmin=1e-5 * u.Hz
    )
    telescope = toast.Telescope("telescope", focalplane=plane, site=site)
    data = toast.Data(toast.Comm())
    toast.ops.SimGround(
        telescope=telescope,
        schedule=toast.schedule.GroundSchedule(scans=[scan]),
        scan_accel_az=1 * u.deg / u.s**2,
        hwp_angle=None,
    ).apply(data)
    toast.ops.DefaultNoiseModel().apply(data)
    toast.ops.SimNoise().apply(data)
    obs = data.obs[0]
    rng = np.random.default_rng(2)
    flags = np.where(rng.random((len(obs.local_detectors), obs.n_local_samples)) < 0.02, 2, 8).astype(np.uint8)
    obs.detdata.ensure("flags", dtype=np.uint8)
    obs.detdata["flags"].data[:] = flags
    folder = tmp_path_factory.mktemp("toast")
    return toast.io.save_hdf5(obs, str(folder))


def test_we_read_what_toast_writes(toast, observed):
    made, data = mm.read_timestreams(observed), loaded(toast, observed)
    obs = data.obs[0]
    assert apart(sights_of(toast, data), sights(made)) < 1e-4 * ARCSEC
    np.testing.assert_allclose(made.data_mk, obs.detdata["signal"].data * 1e3, rtol=1e-15)
    inside = made.scan >= 0
    shared = inside & (obs.shared["flags"].data & 15 != 0)
    np.testing.assert_array_equal(made.flags, (obs.detdata["flags"].data & 7 != 0) | shared)
    np.testing.assert_array_equal([[span.first, span.last] for span in obs.intervals["scanning"]], made.scan_bounds)
    assert made.focal_plane.names.tolist() == obs.local_detectors
    assert made.focal_plane.fwhm_rad == pytest.approx(np.radians(10 / 60))


@pytest.mark.parametrize("order", [0, 3])
def test_maps_of_streams_of_toast(toast, observed, tmp_path, order):
    """Without lost samples, which both leave out of the map, and TOAST also of the mean."""
    data = loaded(toast, observed)
    data.obs[0].detdata["flags"].data[:] = 0
    path = toast.io.save_hdf5(data.obs[0], str(tmp_path))
    made = mm.read_timestreams(path)
    assert made.flags is None or not made.flags[:, made.scan >= 0].any()
    geometry = mm.covering_geometry(*mm.mean_direction(made.ra_rad, made.dec_rad), np.radians(2 / 60), np.radians(4))
    theirs = filtered_and_binned(toast, data, geometry, tmp_path, order)
    assert same_map(our_map(made, geometry, order), *theirs) > 1000


def test_files_of_toast_and_of_ours_are_equal(toast, observed, tmp_path):
    """What TOAST wrote, written by this project, is the same to TOAST."""
    made = mm.read_timestreams(observed)
    mm.write_timestreams(tmp_path / "again.toast.h5", made)
    one, other = (sights_of(toast, loaded(toast, path)) for path in (observed, tmp_path / "again.toast.h5"))
    assert apart(one, other) < 1e-4 * ARCSEC
    again = mm.read_timestreams(tmp_path / "again.toast.h5")
    np.testing.assert_array_equal(again.scan, made.scan)
    np.testing.assert_array_equal(again.flags, made.flags)


def test_compressed_observations(toast, observed, tmp_path):
    """Signal to 5 digits of its rms about the mean of a detector; flags as they are."""
    data, made = loaded(toast, observed), mm.read_timestreams(observed)
    packed = [("signal", {"precision": 5}), ("flags", {"level": 5})]
    read = mm.read_timestreams(toast.io.save_hdf5(data.obs[0], str(tmp_path), detdata=packed))
    np.testing.assert_array_equal(read.flags, made.flags)
    np.testing.assert_allclose(read.data_mk, made.data_mk, atol=1e-4 * np.nanstd(made.data_mk))
