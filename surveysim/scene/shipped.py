"""Scenes by name: in the current directory, in its folder scenarios/, or shipped with the program, as cameras are."""

import re
import tomllib
from pathlib import Path

from surveysim.scene.similar_names import did_you_mean
from surveysim.scene.units import shown

NAME, MAX_NAME = r"[A-Za-z0-9_][A-Za-z0-9_.-]*", 100
HERE = Path("scenarios")


def shipped_folder() -> Path:
    """Folder of the scenes that ship: within the installed package, or next to the package in a clone."""
    package = Path(__file__).parents[1]
    inside = package / "scenarios"
    return inside if inside.is_dir() else package.parent / "scenarios"


def camera_folder() -> Path:
    """Folder of the cameras that ship: scenes with the parameters of published cameras."""
    return shipped_folder() / "cameras"


def camera_titles() -> dict[str, str]:
    """Titles of the cameras that ship, by name, in alphabetical order."""
    paths = sorted(camera_folder().glob("*.toml"))
    return {path.stem: tomllib.loads(path.read_text(encoding="utf-8"))["title"] for path in paths}


def scene_folder() -> Path:
    """Return the folder scenarios/ of the current directory, or else the folder of the scenes that ship."""
    return HERE if HERE.is_dir() else shipped_folder()


def scene_names() -> list[str]:
    """Names of the scenes in scenarios/, and of the scenes and cameras that ship, in alphabetical order."""
    return _names(HERE, shipped_folder(), camera_folder())


def _names(*folders: Path) -> list[str]:
    return sorted({path.stem for folder in folders for path in folder.glob("*.toml")})


def no_such_scene(scene: str) -> str:
    """Return a line on a scene that does not exist: similar names, or else all names of scenes."""
    others = f"a file, a camera (surveysim cameras) or one of {', '.join(_names(HERE, shipped_folder()))} is expected"
    expected = did_you_mean(scene, scene_names()) or others
    return f"{shown(scene)}: no such scene; {expected}"


def is_name(scene: str) -> bool:
    """Return whether a text can be the name of a scene, without a folder or ``.toml``."""
    return bool(re.fullmatch(NAME, scene)) and len(scene) <= MAX_NAME and not scene.endswith(".toml")


def find_scene(scene: str | Path) -> Path:
    """Find the file of a scene.

    Parameters
    ----------
    scene
        Path of a scene file, or the name of a scene without ``.toml``. A file of that name in the current directory
        comes first, then one in its folder scenarios/, then the scenes that ship, then the cameras.

    Returns
    -------
    Path of the file; the argument itself where no file is found.
    """
    name, path = str(scene), Path(scene)
    if not re.fullmatch(NAME, name) or len(name) > MAX_NAME or path.is_file():
        return path
    places = (folder / f"{name}.toml" for folder in (Path(), HERE, shipped_folder(), camera_folder()))
    return next((place for place in places if place.is_file()), path)
