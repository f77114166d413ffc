"""The command track."""

import os

from surveysim.scene.track_table import read_track
from tests.scenes import WHITE_NOISE_SCENE, write_scene


def test_track_is_written_once(call, tmp_path):
    path, out = write_scene(tmp_path, WHITE_NOISE_SCENE), tmp_path / "folder" / "track.ecsv"
    code, said, error = call("track", path, "--out", out, "--observations", "2")
    assert (code, error) == (0, "") and said == f"{out}: 480 samples of 2 observations\n"
    assert read_track(out).n_obs == 2
    code, said, error = call("track", path, "--out", out)
    assert (code, said) == (2, "") and error.startswith(f"{out}: exists; another name, or --force")
    assert call("track", path, "--out", out, "--force")[0] == 0


def test_only_tables_are_overwritten(call, tmp_path):
    """With --force neither the scene, nor a directory, nor a pipe: a write would replace what the name stands for."""
    path = write_scene(tmp_path, WHITE_NOISE_SCENE)
    code, _, error = call("track", path, "--out", path, "--force")
    assert code == 2 and error == f"{path}: found the suffix '.toml'; '.ecsv' is expected, as the table is ECSV\n"
    assert path.read_text() == WHITE_NOISE_SCENE
    (folder := tmp_path / "folder.ecsv").mkdir()
    os.mkfifo(pipe := tmp_path / "pipe.ecsv")
    for out in (folder, pipe):
        assert call("track", path, "--out", out, "--force")[::2] == (
            2,
            f"{out}: found what is no file; the name of a file is expected\n",
        )
    assert folder.is_dir() and pipe.is_fifo()


def test_wrong_numbers_and_sweeps_are_refused(call, tmp_path):
    path, out = write_scene(tmp_path, WHITE_NOISE_SCENE), tmp_path / "track.ecsv"
    assert call("track", path, "--out", out, "--observations", "5") == (
        2,
        "",
        "--observations: found 5; 4 or fewer are expected\n",
    )
    sweep = tmp_path / "sweep.toml"
    sweep.write_text(f'{WHITE_NOISE_SCENE}\n[sweep]\n"scan.speed" = ["4 arcmin / s", "5 arcmin / s"]\n')
    code, _, error = call("track", sweep, "--out", out)
    assert code == 2 and error == f"{sweep}: sweep: found a sweep; a scene without [sweep] is expected\n"
    assert not out.exists()
