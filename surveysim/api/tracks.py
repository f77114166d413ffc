"""The Python interface of tracks: the telescope's directions at each sample."""

import os
from pathlib import Path
from typing import TYPE_CHECKING

from mapmaker.files import write_ecsv
from surveysim.api.surveys import scene_as_given
from surveysim.output.lock import OutputError
from surveysim.reduction.setup import prepare
from surveysim.results.track import track_table
from surveysim.runtime.errors import InputError
from surveysim.scene.scene import Scene
from surveysim.scene.units import shown

if TYPE_CHECKING:
    from astropy.table import QTable


def track(
    scene: Scene | str | Path,
    out: str | Path | None = None,
    *,
    observations: int | None = None,
    force: bool = False,
) -> "QTable":
    """Compute the track of the telescope: the boresight at each sample.

    Parameters
    ----------
    scene
        A scene, the path of its file, or its name.
    out
        ECSV file to write, with the suffix .ecsv; ``pattern = "track"`` reads it. By default none is written.
    observations
        Number of observations, from the first; by default all.
    force
        Overwrite a file that exists.

    Returns
    -------
    Table with the columns `observation`, `start_mjd` (UTC), `time` since the start, `az`, `el`, `ra`, `dec`, and
    `flag`, which is 1 in turnarounds. At fixed pointing `start_mjd`, `az` and `el` are missing; without simulated
    turnarounds `flag` is.

    Raises
    ------
    SceneError
        The scene can't be run.
    InputError
        The scene does not have so many observations.
    OutputError
        The file has another suffix, it exists, without `force`, or it is a directory, a pipe or a device.
    """
    scene = scene_as_given(scene)
    n_obs = scene.observations if observations is None else observations
    if not 1 <= n_obs <= scene.observations:
        raise InputError(f"observations: found {n_obs}; 1 to {scene.observations} is expected")
    if out is not None:
        _check_file(Path(out), force)
    table = track_table(prepare(scene), n_obs)
    if out is not None:
        Path(out).parent.mkdir(parents=True, exist_ok=True)
        write_ecsv(out, table.in_files, table.units, table.meta)
    return table.quantities()


def _check_file(out: Path, force: bool) -> None:
    """Raise OutputError for a name that is none of a table, and for what must not be overwritten."""
    if out.suffix != ".ecsv":
        raise OutputError(f"{out}: found the suffix {shown(out.suffix)}; '.ecsv' is expected, as the table is ECSV")
    if os.path.lexists(out) and not force:
        raise OutputError(f"{out}: exists; another name, or --force (force=True), is expected")
    if out.exists() and not out.is_file():
        raise OutputError(f"{out}: found what is no file; the name of a file is expected")
