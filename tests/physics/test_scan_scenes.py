"""Scenes of scan patterns that ship, shortened; the guide runs the daisy and the layers."""

import pytest

from surveysim import run
from surveysim.results.agreement import forecast_agreement
from surveysim.runtime.engine import SERIAL
from surveysim.scene.scene import load_scene

# Half of the sweeps, so half of the field; a camera in the middle of TolTEC's.
SHORT = {
    "azimuth_fyst": {"scan.scans": 24, "score.size": "20 arcmin", "map.pixel": "20 arcsec"},
    "lissajous_toltec": {"scan.duration": "1 min", "instrument.layout.field_of_view": "2 arcmin"},
}


@pytest.mark.slow
@pytest.mark.parametrize("name", SHORT)
def test_scene_runs_as_forecast(name):
    """Every pixel of the scored square is hit, and sigma(A) is the forecast to 10 % and 3 errors."""
    few = {"score.jackknives": 32, "score.noise_only_sets": []}
    result = run(load_scene(name, few | SHORT[name]), engine=SERIAL)
    rows = result.setup.analysis.region.patch
    assert result.coadds.hits[0][rows, rows].min() > 0
    found = forecast_agreement(result)["actual"]
    assert abs(found.sigma) < 0.1 + 3 * found.sigma_error, found
    assert found.sigma_error < 0.15
