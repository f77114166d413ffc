"""The command track: directions of the telescope as a table."""

from pathlib import Path
from typing import Annotated

import typer

from mapmaker.printable import say
from surveysim.cli.options import Overrides, SceneFile, at_least, bands_of, fail, ready_setup
from surveysim.runtime.numbers import plain, plural


def track(
    scene: SceneFile,
    out: Annotated[Path, typer.Option(metavar="FILE", help="ECSV file to write, such as track.ecsv.")],
    observations: Annotated[
        int | None, typer.Option(metavar="N", help="Number of observations, from the first; by default all.")
    ] = None,
    settings: Overrides = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite the file.")] = False,
) -> None:
    """Write the track of the telescope.

    The table has time, azimuth, elevation, right ascension and declination of the boresight at each sample. A scene
    with pattern = "track" in [scan] reads it back.
    """
    from surveysim.api.tracks import track as write_track
    from surveysim.scene.kinds import is_sweep

    if is_sweep(scene):
        fail(f"{scene}: sweep: found a sweep; a scene without [sweep] is expected")
    scenes = bands_of(scene, settings)  # all bands have the same track
    one = next(iter(scenes.bands.values())) if scenes else ready_setup(scene, settings).scene
    if observations is not None:
        at_least("--observations", observations, 1)
        if observations > one.observations:
            fail(f"--observations: found {observations}; {one.observations} or fewer are expected")
    table = write_track(one, out, observations=observations, force=force)
    size = f"{plural(len(table), 'sample')} of {plural(observations or one.observations, 'observation')}"
    say(f"{out}: {plain(size)}")
