"""Track of the telescope as a table, which the scan pattern "track" reads back."""

import numpy as np

from mapmaker.geometry import plane_directions
from surveysim.runtime.table import Column, Table, file_column
from surveysim.telescope.pointing import Pointing
from surveysim.timestreams.simulation import Simulation, observation_path


def track_table(setup: Simulation, n_obs: int) -> Table:
    """Return a row for each sample of the first observations.

    Without a schedule there are no dates, and no azimuths and elevations. The column `flag` is there if samples of
    turnarounds are simulated: it is 1 for these.
    """
    columns = [_columns(setup, number, observation_path(setup.observing, number)[1]) for number in range(n_obs)]
    joined = tuple(
        Column(parts[0].name, np.concatenate([part.array for part in parts]), parts[0].unit)
        for parts in zip(*columns, strict=True)
    )
    return Table("track", "Track of the telescope", joined, meta={"frame": "ICRS", "refraction": "none"})


def _columns(setup: Simulation, observation: int, pointing: Pointing) -> tuple[Column, ...]:
    n_samp = len(pointing.time_s)
    ra, dec = plane_directions(setup.sky.geometry, pointing.xi_rad, pointing.eta_rad)
    columns = [file_column("observation", np.full(n_samp, observation))]
    if setup.scene.schedule is not None:
        columns.append(file_column("start_mjd", np.full(n_samp, pointing.start_mjd), "d"))
    columns.append(file_column("time", pointing.time_s, "s"))
    if setup.scene.schedule is not None:
        columns.append(file_column("az", np.degrees(pointing.azimuth_rad), "deg"))
        columns.append(file_column("el", np.degrees(pointing.elevation_rad), "deg"))
    columns += [file_column("ra", np.degrees(ra), "deg"), file_column("dec", np.degrees(dec), "deg")]
    if pointing.flagged is not None:
        columns.append(file_column("flag", pointing.flagged.astype(int)))
    return tuple(columns)
