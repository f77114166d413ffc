"""Trees of files before and after: the user's own, and those of a run."""

from hashlib import sha256
from pathlib import Path

import h5py

from surveysim.survey.checkpoint import NAME as CHECKPOINT

# The user's, around and inside an output directory: names that the program's own might be taken for.
AROUND = ("thesis.tex", "data/raw.h5", "data/notes.part", "summary.json", "maps/mine.fits", "checkpoint.h5")
INSIDE = (
    "notes.txt",
    ".writable",
    "figures/movie.part",
    "figures/run.gif.part.bak",
    "maps/mine.fits",
    "maps/actual.fits.old",
    "maps/a.fits.part",
    "tables/draft.ecsv.x.part",
    "timestreams/0000.h5.part",
    "points/readme",
    "mine/actual.fits",
)
# Hold times, or hashes of what does, and differ between equal runs.
TIMED = ("summary.json", "report.html", "figures/run_time.png", ".surveysim.json")


def files(directory: Path) -> dict[str, str]:
    """SHA-256 of every file below a directory, and where every link leads."""
    found = {}
    for path in sorted(directory.rglob("*")):
        name = path.relative_to(directory).as_posix()
        if path.is_symlink():
            found[name] = f"-> {path.readlink()}"
        elif path.is_file():
            found[name] = sha256(path.read_bytes()).hexdigest()
        elif path.is_dir():
            found[name] = "folder"
        else:
            found[name] = "special"
    return found


def plant(root: Path, out: str = "out") -> dict[str, str]:
    """Write the user's files below `root` and in its output directory; returns their hashes by name below `root`."""
    names = [*AROUND, *(f"{out}/{name}" for name in INSIDE)]
    for name in names:
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(f"{name}: the user's own\n")
    now = files(root)
    return {name: now[name] for name in names}


def lost(root: Path, before: dict[str, str]) -> list[str]:
    """Names of files that are gone or changed."""
    now = files(root)
    return sorted(name for name, was in before.items() if now.get(name) != was)


def results(directory: Path) -> dict[str, str]:
    """Hashes of what a run left, less the user's files; those that hold times only by name, or without the times."""
    mine = set(INSIDE) | {Path(name).parent.as_posix() for name in INSIDE}
    found = {name: item for name, item in files(directory).items() if name not in mine and item != "folder"}
    if CHECKPOINT in found:
        found[CHECKPOINT] = _sums(directory / CHECKPOINT)
    timed = {*TIMED, *(name for name in found if name.startswith("points/") and Path(name).name in TIMED)}
    return found | {name: "timed" for name in timed if name in found}


def _sums(checkpoint: Path) -> str:
    """SHA-256 of the sums in a checkpoint, with their names and the scene, but without times."""
    with h5py.File(checkpoint) as file:
        digest = sha256(file.attrs["meta"].encode())
        for first, node in file.items():
            for name, values in node.items():
                digest.update(f"{first} {name} {values.shape} {values.dtype}".encode() + values[()].tobytes())
    return digest.hexdigest()
