"""G3 frames: round trips, the pointing of spt3g's own maps, and frames that other programs write."""

from dataclasses import replace

import numpy as np
import pytest

import mapmaker as mm
from mapmaker.errors import InputError
from mapmaker.formats import g3
from tests.exchange.streams import ARCSEC, apart, sights, streams

pytestmark = pytest.mark.exchange


@pytest.fixture
def frames(tmp_path):
    """Frames of a file as it is written, to be changed."""
    from spt3g import core

    mm.write_timestreams(tmp_path / "good.g3", streams(flagged=True))
    return [frame for frame in core.G3File(str(tmp_path / "good.g3")) if frame.type != core.G3FrameType.EndProcessing]


def written(path, frames):
    """Write frames of other programs."""
    from spt3g import core

    writer = core.G3Writer(str(path))
    for frame in frames:
        writer(frame)
    writer(core.G3Frame(core.G3FrameType.EndProcessing))
    return path


def changed(frame, **entries):
    """Change the entries of a frame; None removes one."""
    for name, value in entries.items():
        if name in frame:
            del frame[name]
        if value is not None:
            frame[name] = value


def test_round_trip(tmp_path, recwarn):
    made = streams(flagged=True)
    mm.write_timestreams(tmp_path / "one.g3", made)
    again = mm.read_timestreams(tmp_path / "one.g3")
    assert not recwarn.list and [item.name for item in tmp_path.iterdir()] == ["one.g3"]
    assert apart(sights(again), sights(made)) < 1e-4 * ARCSEC
    np.testing.assert_array_equal(again.data_mk, made.data_mk)
    np.testing.assert_allclose(again.time_s, made.time_s, atol=1e-8, rtol=0)
    np.testing.assert_array_equal(again.scan, made.scan)
    np.testing.assert_array_equal(again.flags, made.flags)
    np.testing.assert_allclose(again.focal_plane.angle_rad, made.focal_plane.angle_rad, rtol=1e-14)
    np.testing.assert_allclose(np.sin(again.array_angle_rad), np.sin(made.array_angle_rad), rtol=1e-12)
    assert again.focal_plane.names.tolist() == made.focal_plane.names.tolist()
    assert dict(again.attributes) == dict(made.attributes)


def test_positions_are_those_of_spt3g(tmp_path, frames):
    """The rotations and the offsets of the detectors, as spt3g's map-makers use them."""
    from spt3g import core, maps

    made, found = streams(), []
    properties = next(frame for frame in frames if frame.type == core.G3FrameType.Calibration)["BolometerProperties"]
    for frame in frames:
        if frame.type != core.G3FrameType.Scan:
            continue
        of_frame = []
        for name in made.focal_plane.names.tolist():
            item = properties[name]
            ra, dec = maps.get_detector_pointing(
                item.x_offset, item.y_offset, frame["OnlineRaDecRotation"], maps.MapCoordReference.Equatorial
            )
            ra, dec = (np.array(angle) / core.G3Units.rad for angle in (ra, dec))
            of_frame.append(np.moveaxis([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)], 0, -1))
        found.append(np.array(of_frame))
    assert apart(np.concatenate(found, axis=1), sights(made)) < 1e-4 * ARCSEC


def test_horizon(tmp_path, frames):
    """Azimuth and elevation with a site: the sky of astropy; up in the array is the direction of the zenith."""
    from astropy import units as u
    from astropy.coordinates import AltAz, EarthLocation, SkyCoord
    from astropy.time import Time
    from spt3g import core

    made = streams()
    site = EarthLocation.from_geodetic(-67.78 * u.deg, -22.95 * u.deg, 5200 * u.m)
    az = np.linspace(1.0, 1.1, len(made.time_s))
    el, done = 0.8 + 0 * az, 0
    for frame in frames:
        if frame.type == core.G3FrameType.Observation:
            changed(frame, site_lon_deg=-67.78, site_lat_deg=-22.95, site_alt_m=5200.0)
        if frame.type != core.G3FrameType.Scan:
            continue
        part = slice(done, done + len(frame["DetectorSampleTimes"]))
        angle = core.G3TimestreamUnits.Angle
        changed(
            frame,
            OnlineRaDecRotation=None,
            BoresightAz=core.G3Timestream(az[part] * core.G3Units.rad, angle),
            BoresightEl=core.G3Timestream(el[part] * core.G3Units.rad, angle),
        )
        done = part.stop
    found = mm.read_timestreams(written(tmp_path / "horizon.g3", frames))
    frame = AltAz(obstime=Time(made.time_s, format="unix"), location=site)
    x, y = made.focal_plane.x_rad, made.focal_plane.y_rad
    for row in range(len(x)):  # x points right: to larger azimuths
        sky = [np.cos(el) * np.cos(az), np.cos(el) * np.sin(az), np.sin(el)]
        up = [-np.sin(el) * np.cos(az), -np.sin(el) * np.sin(az), np.cos(el)]
        right = [-np.sin(az), np.cos(az), 0 * az]
        vector = np.array(sky) + x[row] * np.array(right) + y[row] * np.array(up)
        line = SkyCoord(
            az=np.arctan2(vector[1], vector[0]) * u.rad,
            alt=np.arctan2(vector[2], np.hypot(vector[0], vector[1])) * u.rad,
            frame=frame,
        ).icrs
        expected = np.moveaxis(line.cartesian.xyz.value, 0, -1)
        # Aberration changes offsets of 10 arcmin by 1e-4 of them.
        assert apart(sights(found)[row], expected) < 0.1 * ARCSEC


def test_frames_without_optional_keys(tmp_path, frames):
    """Times follow from start and stop; scans are counted; flags of spt3g are of whole scans; the beam is given."""
    from spt3g import core

    flags = core.G3MapVectorString()
    flags["d2"] = ["Glitchy"]
    for frame in frames:
        if frame.type == core.G3FrameType.Calibration:
            changed(frame, BeamFWHM=None, DetectorNames=None)
        if frame.type == core.G3FrameType.Scan:
            changed(frame, DetectorSampleTimes=None, ScanNumber=None, SampleFlags=None, Flags=flags)
    path = written(tmp_path / "less.g3", frames)
    with pytest.raises(ValueError, match="lacks BeamFWHM; give the beam"):
        mm.read_timestreams(path)
    found, made = mm.read_timestreams(path, fwhm_rad=1e-3), streams()
    np.testing.assert_allclose(found.time_s, made.time_s, atol=2e-8, rtol=0)
    np.testing.assert_array_equal(np.unique(found.scan), [-1, 0, 1, 2, 3])
    np.testing.assert_array_equal(found.scan_bounds, made.scan_bounds)
    assert found.flags[2].all() and not np.delete(found.flags, 2, axis=0).any()
    assert found.focal_plane.fwhm_rad == 1e-3


def wrong_frames():
    """Keys of the Scan or the Calibration frame, their wrong value, and the words of the error."""
    from spt3g import core

    counts = core.G3TimestreamMap()
    for number in range(7):
        counts[f"d{number}"] = core.G3Timestream(np.zeros(100), core.G3TimestreamUnits.Counts)
    short = core.G3TimestreamMap()
    short["d0"] = core.G3Timestream(np.zeros(100), core.G3TimestreamUnits.Trj)
    edges = core.G3MapVectorInt()
    edges["d0"] = [5, 3]
    rotation = core.G3VectorQuat(np.tile([1.0, 1.0, 0, 0], (100, 1)))
    nan = core.G3VectorQuat(np.tile([np.nan, 0, 0, 0], (100, 1)))
    few = core.G3VectorQuat(np.tile([1.0, 0, 0, 0], (9, 1)))
    scan, cal = core.G3FrameType.Scan, core.G3FrameType.Calibration
    return [
        (scan, {"CalTimestreams": counts}, "the unit of CalTimestreams: found Counts; Trj or Tcmb is expected"),
        (scan, {"CalTimestreams": short}, "'d1' is in CalTimestreams or in BolometerProperties only"),
        (scan, {"CalTimestreams": None}, "a Scan frame lacks CalTimestreams"),
        (scan, {"OnlineRaDecRotation": None}, "a Scan frame lacks OnlineRaDecRotation"),
        (scan, {"OnlineRaDecRotation": rotation}, "OnlineRaDecRotation: found a quaternion of the length 1.41421"),
        (scan, {"OnlineRaDecRotation": nan}, "OnlineRaDecRotation: found nan"),
        (scan, {"OnlineRaDecRotation": few}, "OnlineRaDecRotation: found the shape"),
        (scan, {"SampleFlags": edges}, r"SampleFlags: found \[5, 3\]; pairs of increasing samples are expected"),
        (
            scan,
            {"DetectorSampleTimes": core.G3VectorTime()},
            r"CalTimestreams\['d0'\] has the shape \(100,\); \(0,\) is expected",
        ),
        (scan, {"ScanNumber": core.G3String("x")}, "ScanNumber: found 'x'; an integer of at least 0 is expected"),
        (cal, {"BolometerProperties": None}, "found 0 frames with BolometerProperties and 6 Scan frames"),
        (cal, {"BeamFWHM": -1.0}, "fwhm_rad: found -1.0"),
    ]


@pytest.mark.parametrize("row", range(12))
def test_wrong_frames_are_refused(tmp_path, frames, row):
    kind, entries, words = wrong_frames()[row]
    for frame in frames:
        if frame.type == kind:
            changed(frame, **entries)
    path = written(tmp_path / "wrong.g3", frames)
    with pytest.raises(InputError, match=words) as caught:
        mm.read_timestreams(path)
    assert str(caught.value).startswith(f"{path}: ") and "\n" not in str(caught.value)


@pytest.mark.parametrize("seed", range(4))
def test_mangled_frames(tmp_path, seed, capfd):
    """Bytes of the file are others, or it ends early: an error of one line, or what it held, and nothing else said."""
    mm.write_timestreams(tmp_path / "good.g3", streams())
    rng, whole, path = np.random.default_rng(seed), (tmp_path / "good.g3").read_bytes(), tmp_path / "mangled.g3"
    for _ in range(8):
        mangled = bytearray(whole)
        for place in rng.integers(0, len(whole), 3):
            mangled[place] = rng.integers(0, 256)
        path.write_bytes(mangled[: rng.integers(len(whole) // 4, len(whole))] if rng.random() < 0.4 else mangled)
        try:
            assert np.isfinite(mm.read_timestreams(path).ra_rad).all()
        except ValueError as error:
            assert str(error).startswith(f"{path}: ") and "\n" not in str(error) and len(str(error)) < 500
    assert capfd.readouterr().err == ""


def test_suffix_and_losses(tmp_path):
    with pytest.raises(ValueError, match="found no suffix .g3, which spt3g expects of its files"):
        mm.write_timestreams(tmp_path / "one.frames", streams(), format="g3")
    with pytest.warns(UserWarning, match="one.g3: format g3 does not hold attributes that are arrays"):
        mm.write_timestreams(tmp_path / "one.g3", replace(streams(), attributes={"many": np.arange(3)}))
    assert g3.losses(streams()) == ()
