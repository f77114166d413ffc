"""Records of an accuracy study: settings, their measured errors and times, slopes and recommendations."""

from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from mapmaker.uncertainty import ErrorBudget
from surveysim.reduction.setup import Setup
from surveysim.runtime.numbers import number, plain
from surveysim.runtime.table import Table, column
from surveysim.scene.scene import Scene

SUB_SURVEY = 60  # observations for all ladders but the number of observations
REFERENCE_ERROR, MOST_SEEDS = 0.01, 8
PARTS = (16, 8, 4, 2, 1)  # divisors of the number of observations
FLIPS, SKIES, SIGNAL_SIM_PARTS = (8, 16, 32, 64, 128), (2, 4, 8), (20, 5, 2)
STEPS, RATES = (4.0, 2.0, 1.0, 0.5), (0.5, 1.0, 2.0)
FINEST = {"numerics.precision": "float64", "numerics.interpolation": "cubic", "numerics.screen_step": min(STEPS)}
OF_SCREEN = ("screen step", "interpolation")
TOLERATED = 1 / 3  # tolerated bias over the Monte Carlo error of the whole survey: it adds 5 % to the error
MUCH_WORSE, MUCH_FASTER = 1.1, 1.1  # significant ratios of errors and of times

Kind = Literal["survey", "sampling", "numerical", "forecast"]


@dataclass(frozen=True)
class Setting:
    """A step of a parameter's ladder, by the scene keys that it replaces; `own` for the scene's own value."""

    parameter: str
    label: str
    overrides: dict[str, Any]
    kind: Kind
    own: bool


@dataclass(frozen=True)
class Measured:
    """Accuracy and cost of a setting; NaN if it could not be run.

    Attributes
    ----------
    setting, observations
        The setting, and the number of observations that it was run with.
    sigma_ukcmb2, error_ukcmb2
        sigma(A) and its Monte Carlo error in one run [uK_CMB^2].
    bias, bias_error
        Ratio of sigma(A) to the reference's, less 1, and the paired error.
    wall_s, cpu_s
        Time of the observations and of their score [s], without `start_s`.
    start_s
        Time to prepare the scene and to observe once [s].
    peak_mb
        Peak memory of the process since it began, earlier settings included [MB].
    raised_mb
        Increase of the peak by this setting [MB].
    budget
        Parts of the Monte Carlo error.
    note
        Reason why the setting could not be run.
    """

    setting: Setting
    observations: int
    sigma_ukcmb2: float = np.nan
    error_ukcmb2: float = np.nan
    bias: float = np.nan
    bias_error: float = np.nan
    wall_s: float = np.nan
    cpu_s: float = np.nan
    start_s: float = np.nan
    peak_mb: float = np.nan
    raised_mb: float = np.nan
    budget: ErrorBudget | None = None
    note: str = ""

    @property
    def relative_error(self) -> float:
        """Monte Carlo error over sigma(A)."""
        return self.error_ukcmb2 / self.sigma_ukcmb2


@dataclass(frozen=True)
class Slope:
    """Slope of ln y against ln x, with its error from the scatter about the line (NaN for less than 3 points)."""

    name: str
    value: float
    error: float


@dataclass(frozen=True)
class Recommendation:
    """The fastest setting of a parameter that is good enough.

    `is_own`: it is the scene's own; `resolved`: the error of its bias is below the tolerated bias.
    """

    parameter: str
    label: str
    is_own: bool
    resolved: bool


@dataclass(frozen=True)
class AccuracyResult:
    """All ladders of a scene.

    Attributes
    ----------
    reference_error, wanted_error
        Relative error of the mean of `seeds` whole surveys, and the error requested for it.
    scatter
        Scatter between seeds over the error that each run quotes (NaN for one seed).
    own_error
        Relative Monte Carlo error of a run of the scene.
    sub_observations
        Number of observations for the other ladders.
    """

    setup: Setup = field(repr=False)
    seeds: int
    reference_ukcmb2: float
    reference_error: float
    wanted_error: float
    scatter: float
    own_error: float
    sub_observations: int
    rows: tuple[Measured, ...]
    slopes: tuple[Slope, ...]
    recommended: tuple[Recommendation, ...]
    wall_s: float
    workers: int

    @property
    def scene(self) -> Scene:
        """The scene."""
        return self.setup.scene

    @property
    def chosen(self) -> tuple[int, ...]:
        """Rows of the scene's own settings."""
        return tuple(index for index, row in enumerate(self.rows) if row.setting.own)

    def __repr__(self) -> str:
        """Two lines about the study above the table of recommended settings."""
        reference = f"{number(self.reference_ukcmb2)} uK_CMB^2, known to {100 * self.reference_error:.2g} %"
        return (
            f"AccuracyResult of {self.scene.name}: {len(self.rows)} settings\n"
            f"Reference: sigma(A) = {plain(reference)}\n{self._table().text()}"
        )

    def _repr_html_(self) -> str:
        """The table of recommended settings."""
        return self._table().html()

    def _table(self) -> Table:
        own = {row.setting.parameter: row.setting.label for row in self.rows if row.setting.own}
        columns = (
            column("parameter", [item.parameter for item in self.recommended], "parameter"),
            column("recommended", [item.label for item in self.recommended], "recommended setting"),
            column("own", [own.get(item.parameter) for item in self.recommended], "the scene's own"),
        )
        return Table("recommended", "Fastest settings that are good enough", columns)
