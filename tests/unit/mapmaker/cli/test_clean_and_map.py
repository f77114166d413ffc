"""Command `mapmaker clean-and-map`: its files, its exit codes, and what an interruption leaves."""

import json
import re

import numpy as np
import pytest
from astropy.io import fits
from astropy.table import Table
from astropy.wcs import WCS

import mapmaker as mm
from mapmaker.cli.main import ended
from mapmaker.pipeline import outputs, run
from tests.unit.mapmaker.pipeline.made import CENTRE, changed, streams, written

EXPECTED = {"map.fits", "report.html", "dropped.ecsv", "files.ecsv", "detectors.ecsv", "noise_psd.ecsv", "config.json"}


@pytest.fixture(scope="module")
def paths(tmp_path_factory):
    """Two files; the second has a dead detector and a name that HTML would take for a tag."""
    folder = tmp_path_factory.mktemp("streams")

    def kill(data, bounds):
        data[4] = 1.0

    first, second = written(folder, [streams(0), changed(streams(1), kill)])
    return [first, second.rename(folder / "<b>&.h5")]


def names(folder):
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}


def test_results(paths, tmp_path, capsys):
    (tmp_path / "map.toml").write_text('[map]\npixel = "30 arcsec"\nhealpix_nside = 4096\n')
    broken = tmp_path / "broken.h5"
    broken.write_bytes(b"")
    out = tmp_path / "new" / "out"
    words = ["clean-and-map", *map(str, paths), str(broken), "--config", str(tmp_path / "map.toml"), "--out", str(out)]
    assert ended(words) == 3
    said = capsys.readouterr()
    assert said.err.splitlines()[:4] == [f"reading: {k}/3 files" for k in (1, 2, 3)] + ["cleaning: 1/2 files"]
    assert said.out.splitlines()[0] == "2 of 3 files mapped, 98.0 % of their samples"
    assert "  constant: 1 detector, 1920 samples" in said.out and f"report in {out / 'report.html'}" in said.out
    noise = {"noise/files_1.fits", "noise/time.fits", "noise/direction.fits", "noise/detectors.fits"}
    assert names(out) <= EXPECTED | noise | {"healpix.fits"} and EXPECTED | {"healpix.fits"} <= names(out)
    item = mm.read_fits(out / "map.fits")
    with fits.open(out / "map.fits") as file:
        assert (file[0].header["NFILES"], file["SIGNAL"].header["BUNIT"]) == (2, "mK")
        row, column = np.unravel_index(np.argmax(file["SIGNAL"].data), file["SIGNAL"].data.shape)
        assert WCS(file["SIGNAL"].header).pixel_to_world_values(column, row) == pytest.approx(CENTRE, abs=0.02)
    with fits.open(out / "healpix.fits") as file:
        assert file[1].data["HITS"].sum() == item.hits.sum()
    table = Table.read(out / "dropped.ecsv").filled("")
    assert [tuple(row) for row in table["file", "reason", "detector"]] == [
        ("broken.h5", "unreadable", ""),
        ("<b>&.h5", "constant", "d04"),
    ]
    assert Table.read(out / "files.ecsv")["n_det_used"].tolist() == [25, 24, 0]
    assert len(Table.read(out / "detectors.ecsv")) == 49
    assert Table.read(out / "noise_psd.ecsv")["time"].unit == "mK2 sr"
    assert json.loads((out / "config.json").read_text())["map"]["healpix_nside"] == 4096
    page = (out / "report.html").read_text()
    assert "&lt;b&gt;&amp;.h5" in page and "<b>" not in page and page.count("data:image/png") == 3
    assert not re.search(r"(src|href)=\"(http|//)", page)


def test_earlier_results_are_replaced_on_request(paths, tmp_path, capsys):
    out = tmp_path / "out"
    (out / "noise").mkdir(parents=True)
    for name in ("healpix.fits", "noise/files_9.fits", "mine.txt"):
        (out / name).write_text("old")
    words = ["clean-and-map", str(paths[0]), "--out", str(out), "--quiet"]
    assert ended(words) == 2
    assert capsys.readouterr().err.startswith(f"{out}: found files in it; --force replaces results")
    assert ended([*words, "--force"]) == 0
    assert capsys.readouterr() == ("", "")
    assert {"mine.txt"} | EXPECTED <= names(out) and not {"healpix.fits", "noise/files_9.fits"} & names(out)


@pytest.mark.parametrize("where", ["cleaning", "writing"])
def test_an_interruption_leaves_the_directory_as_it_was(where, paths, tmp_path, capsys, monkeypatch):
    called = []

    def interrupted(*arguments):
        called.append(1)
        if where == "writing" or len(called) > 1:
            raise KeyboardInterrupt
        return clean_file(*arguments)

    clean_file = run.clean_file
    monkeypatch.setattr(*((run, "clean_file") if where == "cleaning" else (outputs, "write_report")), interrupted)
    new, old = tmp_path / "new", tmp_path / "old"
    old.mkdir()
    (old / "map.fits").write_text("old")
    for out in (new, old):
        called.clear()
        assert ended(["clean-and-map", *map(str, paths), "--out", str(out), "--force", "--quiet"]) == 130
        done = 1 if where == "cleaning" else 2
        assert capsys.readouterr().err == (
            f"interrupted; {done} of 2 files were cleaned; nothing is kept of them, {out} is as before\n"
        )
    assert not new.exists() and names(old) == {"map.fits"} and (old / "map.fits").read_text() == "old"


def test_nothing_to_map(tmp_path, capsys):
    def nothing(data, bounds):
        data[:] = np.nan

    (path,) = written(tmp_path, [changed(streams(0), nothing)])
    words = ["clean-and-map", str(path), str(tmp_path / "nowhere.h5"), "--out", str(tmp_path / "out"), "-q"]
    assert ended(words) == 2
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "nothing is left to map" and len(lines) == 3
    assert {line.partition(":")[0] for line in lines[1:]} == {"000.h5", "nowhere.h5"}
    assert not (tmp_path / "out").exists()


def test_wrong_words(paths, tmp_path, capsys):
    for words, said in (
        ([str(paths[0])], "Missing option '--out'"),
        (["--out", str(tmp_path / "out")], "Missing argument"),
        ([str(paths[0]), "--out", str(paths[0])], "found a file; a directory is expected"),
        ([str(paths[0])] * 2 + ["--out", str(tmp_path / "out")], "found twice among the files"),
        ([str(paths[0]), "--out", str(tmp_path / "out"), "--config", "no.toml"], "no.toml: no such file"),
    ):
        assert ended(["clean-and-map", *words]) == 2
        assert said in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
