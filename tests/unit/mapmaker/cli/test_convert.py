"""Command `mapmaker convert`: files, lines and refusals."""

from dataclasses import replace

import numpy as np
import pytest

import mapmaker as mm
from mapmaker.cli import main
from tests.exchange.streams import ARCSEC, apart, sights, streams


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    made = streams()
    for name in ("one.h5", "two.toast.h5"):
        mm.write_timestreams(name, made)
    return made


def test_files_of_any_format(folder, capsys):
    assert main.ended(["convert", "one.h5", "two.toast.h5", "--to", "mustang2", "--out", "fits"]) == 0
    said = capsys.readouterr()
    assert said.out == "".join(
        f"{name}{end} -> fits/{name}.fits: 7 detectors, 600 samples, 4 scans\n"
        for name, end in (("one", ".h5"), ("two", ".toast.h5"))
    )
    lost = "the boresight and the zero point of the array angle, names of detectors, polarization angles, attributes"
    assert said.err == "".join(f"fits/{name}.fits: format mustang2 does not hold {lost}\n" for name in ("one", "two"))
    assert main.ended(["convert", "fits/one.fits", "--to", "toast", "--out", ".", "--beam", "9"]) == 0
    again = mm.read_timestreams("one.toast.h5")
    assert apart(sights(again), sights(folder)) < 1e-4 * ARCSEC
    assert again.focal_plane.fwhm_rad == pytest.approx(9 * ARCSEC)
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(
    "arguments, line",
    [
        (["one.h5", "--to", "csv"], "format: found 'csv'; one of toast, hdf5, g3, mustang2 is expected"),
        (["none.h5", "--to", "toast"], "none.h5: no such file; a time-stream file is expected"),
        (["one.h5", "--to", "hdf5", "--out", "."], "one.h5: found a file; --force replaces it"),
        (
            ["one.h5", "./one.h5", "--to", "toast"],
            "out/one.toast.h5: found two files of this name; different names are expected",
        ),
        (["one.h5", "--to", "toast", "--beam", "0"], "--beam: found 0.0; a number above 0 and below 3600 is expected"),
        (
            ["one.h5", "--to", "toast", "--beam", "nan"],
            "--beam: found nan; a number above 0 and below 3600 is expected",
        ),
    ],
)
def test_refusals(folder, arguments, line, capsys):
    options = [] if "--out" in arguments else ["--out", "out"]
    assert main.ended(["convert", *arguments, *options]) == 2
    assert capsys.readouterr().err == f"{line}\n"


def test_values_that_a_format_cannot_hold(folder, capsys):
    mm.write_timestreams("odd.h5", replace(folder, attributes={"a:b": 3}))
    assert main.ended(["convert", "odd.h5", "--to", "toast", "--out", "out"]) == 2
    assert capsys.readouterr().err.startswith("out/odd.toast.h5: attributes['a:b']: found ")
    mm.write_timestreams("large.toast.h5", replace(folder, data_mk=folder.data_mk.astype(float) * 1e40))
    assert main.ended(["convert", "large.toast.h5", "--to", "hdf5", "--out", "out"]) == 2
    assert "numbers that single precision holds are expected" in capsys.readouterr().err


def test_force_replaces_files(folder):
    assert main.ended(["convert", "two.toast.h5", "--to", "hdf5", "--out", ".", "--force"]) == 0
    assert main.ended(["convert", "one.h5", "--to", "hdf5", "--out", ".", "--force"]) == 0
    np.testing.assert_array_equal(mm.read_timestreams("one.h5").data_mk, folder.data_mk)
