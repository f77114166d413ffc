"""Output directories, folders and files that are links to the user's: what they lead to stays as it is."""

import os
import shutil
import signal

import pytest

from surveysim.cli.main import ended
from tests.stress.commands import SCENE, SWEEP
from tests.trees import files

pytestmark = pytest.mark.slow

SHORT = SCENE.replace("observations = 16", "observations = 3")
# Where a link stands, and what of the user's it leads to.
LINKS = {
    "out": "mine",
    "out/maps": "mine/maps",
    "out/tables": "mine/tables",
    "out/figures": "mine",
    "out/timestreams": "mine/timestreams",
    "out/points": "mine/points",
    "out/summary.json": "mine/summary.json",
    "out/checkpoint.h5": "mine/raw.h5",
    "out/maps/actual.fits": "mine/maps/mine.fits",
    "out/report.html": "mine/thesis.tex",
    "out/scene.json": "missing",
    "out/scene.toml": "mine/thesis.tex",
    "out/tables/scores.ecsv": "out/tables/scores.ecsv",
}
MINE = (
    "thesis.tex",
    "raw.h5",
    "download.part",
    "actual.fits.77.part",
    "summary.json.99.part",
    ".writable",
    "maps/mine.fits",
    "maps/actual.fits.12.part",
    "tables/old.ecsv",
    "timestreams/0000.h5.5.part",
    "timestreams/0007.h5",
    "points/000.npz.bak",
    "points/notes",
)


@pytest.fixture
def call(monkeypatch, capsys, tmp_path):
    """Run the command line here; returns exit code and standard error."""
    monkeypatch.chdir(tmp_path)
    kept = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield lambda arguments: (ended(arguments), capsys.readouterr().err)
    for number, handler in kept.items():
        signal.signal(number, handler)


@pytest.mark.parametrize("earlier", [False, True], ids=["new", "over-a-run"])
@pytest.mark.parametrize("link", LINKS)
def test_links(tmp_path, call, link, earlier):
    mine = tmp_path / "mine"
    for name in MINE:
        (mine / name).parent.mkdir(parents=True, exist_ok=True)
        (mine / name).write_text(f"{name}: the user's own\n")
    (mine / "summary.json").write_text('{"files": ["thesis.tex", "maps/mine.fits"], "surveysim": "0.2.0"}\n')
    (tmp_path / "scene.toml").write_text(SWEEP if link == "out/points" else SHORT)
    arguments = ("run", "scene.toml", "--engine", "serial", "--no-figures", "--save-timestreams", "-q", "--out", "out")
    if link == "out/points":
        arguments = tuple(item for item in arguments if item != "--save-timestreams")
    if earlier:
        code, error = call(arguments)
        assert code == 0, error
    place = tmp_path / link
    place.parent.mkdir(parents=True, exist_ok=True)
    if place.is_dir():
        shutil.rmtree(place)
    place.unlink(missing_ok=True)
    place.symlink_to(os.path.relpath(tmp_path / LINKS[link], place.parent))
    before = files(mine)
    code, error = call(arguments)
    after = files(mine)
    changed = [name for name in before if after.get(name) != before[name]]
    assert not changed, f"exit code {code}: changed {changed}"
    assert code in (0, 1, 2) and "Traceback" not in error
    assert code == 0 or len(error.strip().splitlines()) == 1
    added = [name for name in after if name not in before and name.endswith(".part")]
    assert not added, f"partial files in the user's tree: {added}"
