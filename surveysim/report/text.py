"""Results and plans as text: tables on the terminal."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.table import Table
from rich.text import Text

from surveysim.plan import Plan
from surveysim.results import METHOD, Row, SurveyResult, score_rows, summary
from surveysim.scene import Scene

if TYPE_CHECKING:
    from astropy.table import Table as AstropyTable


def print_result(result: SurveyResult, directory: Path) -> None:
    """Score table beside the reference, gains, what is assumed, time taken and where the files are."""
    console = _console()
    if len(result.setup.whole_recipes) > 1:
        console.print(_cleaning_table(result))
    if result.scores:
        console.print(_score_table(result))
        for line in gain_lines(result):
            console.print(line, highlight=False)
        console.print()
        if result.alternatives:
            console.print(_alternative_table(result))
        console.print("\nMethod, where the reference leaves it open:", highlight=False)
        for line in METHOD:
            console.print(f"  - {line}", highlight=False, markup=False)
    if result.unscored:
        console.print(f"Not scored: {result.unscored}", highlight=False, markup=False)
    if result.setup.scene.assumed:
        console.print("\nAssumed or calibrated in the scene:", highlight=False)
        for line in result.setup.scene.assumed:
            console.print(f"  - {line}", highlight=False, markup=False)
    console.print(f"\n{closing_line(result)}\nResults in {directory}", highlight=False, markup=False)


def _console() -> Console:
    # Off a terminal rich takes 80 columns, in which the tables would break.
    return Console(soft_wrap=True, width=None if sys.stdout.isatty() else 120)


def closing_line(result: SurveyResult) -> str:
    """What was done and how long it took."""
    content = summary(result)
    scans = f"{content['scans_discarded']} of {content['scans']} scans discarded"
    return (
        f"{content['observations']} observations, {content['detector_samples'] / 1e6:.4g} million "
        f"detector-samples, {scans}, {result.wall_s:.1f} s with {result.workers} worker(s)"
    )


def gain_lines(result: SurveyResult) -> list[str]:
    """Gains between data sets, beside the reference's."""
    reference = result.setup.scene.score.reference
    published = dict(reference.gains) if reference else {}
    lines = []
    for name, item in result.gains.items():
        beside = f"   (reference {published[name]:g})" if name in published else ""
        lines.append(f"  {name} = {item.ratio:.2f} +- {item.error:.2f}{beside}")
    return lines


def _score_table(result: SurveyResult) -> Table:
    reference = result.setup.scene.score.reference
    # As Text: a plain string's square brackets would be taken for markup.
    table = Table(title=Text(f"{result.setup.scene.title}: uncertainty on a flat CMB band power"))
    for heading in ("data set", "detectors", "sigma(A) [uK_CMB^2]", "ell_eff", "FWHM"):
        table.add_column(Text(heading), justify="left" if heading == "data set" else "right")
    if reference:
        table.add_column(Text(reference.source), justify="right")
        table.add_column("ratio", justify="right")
    for row in score_rows(result):
        table.add_row(*_cells(row, reference is not None))
    return table


def _cells(row: Row, with_reference: bool) -> list[str]:
    cells = [
        row.name,
        str(row.n_det),
        f"{row.sigma_ukcmb2:.1f} +- {row.error_ukcmb2:.1f}",
        f"{row.ell_eff:.0f}",
        f"{row.fwhm_ell:.0f}",
    ]
    if with_reference and row.reference_ukcmb2 is not None:
        cells += [f"{row.reference_ukcmb2:g}", f"{row.sigma_ukcmb2 / row.reference_ukcmb2:.2f}"]
    return cells


def _cleaning_table(result: SurveyResult) -> Table:
    """What each way of cleaning costs and leaves, and of how many observations it is the best."""
    table = Table(title=Text("Cleaning: what it costs, and what it leaves"))
    entries = {recipe.label: summary(result)["cleaning"][recipe.data_set] for recipe in result.setup.whole_recipes}
    first = next(iter(entries.values()))
    shares = {"point_source_flux_removed": "flux removed", "best_for_cmb": "best: CMB"}
    shares["best_for_point_source"] = "best: source"
    headings = ["cleaning", "scans discarded", "iterations", "templates"]
    headings += [f"PSD / high, {hz}" for hz in first["psd_over_white"]]
    for heading in headings + [heading for name, heading in shares.items() if name in first]:
        table.add_column(heading, justify="left" if heading == "cleaning" else "right")
    for label, entry in entries.items():
        cells = [str(entry["scans_discarded"]), f"{entry['mean_iterations']:.1f}", f"{entry['mean_removed']:.2f}"]
        cells += [f"{ratio:.3g}" for ratio in entry["psd_over_white"].values()]
        table.add_row(label, *cells, *(f"{100 * entry[name]:.1f} %" for name in shares if name in entry))
    return table


def _alternative_table(result: SurveyResult) -> Table:
    rows = result.alternatives
    table = Table(title=Text("The same data scored otherwise: sigma(A) [uK_CMB^2]"))
    for name in rows[0]:
        table.add_column(name.replace("_", " "), justify="right")
    for row in rows:
        table.add_row(*(value if isinstance(value, str) else f"{value:.0f}" for value in row.values()))
    return table


def print_plan(scene: Scene, plan: Plan, workers: int) -> None:
    """Stages, what is left out and why, and the predicted cost."""
    console = _console()
    table = Table(title=Text(f"{scene.name}: {scene.title}"))
    for heading in ("stage", "what"):
        table.add_column(heading)
    for name, what in plan.stages.items():
        table.add_row(name, what)
    for name, reason in plan.left_out.items():
        table.add_row(Text(name, style="dim"), Text(f"left out: {reason}", style="dim"))
    console.print(table)
    lines = (
        f"about {plan.wall_s:.0f} s with {workers} worker(s), predicted from one observation made here",
        f"about {plan.memory_bytes / 1e6:.0f} MB a process",
        f"about {plan.output_bytes / 1e6:.1f} MB of results",
        f"about {plan.timestream_bytes / 1e6:.0f} MB of time-streams, if saved",
        f"{plan.detector_samples / 1e6:.4g} million detector-samples",
    )
    console.print("\n".join(lines), highlight=False)


def print_paper(written: list[Path]) -> None:
    """The tables that were made, figures as their captions, and where the files are."""
    from astropy.table import Table as AstropyTable

    console = _console()
    for path in written:
        if path.suffix == ".ecsv" and not path.stem.startswith("measurements"):
            made = AstropyTable.read(path, format="ascii.ecsv")
            if path.stem.startswith("figure"):
                console.print(f"\n{made.meta['title']}: {made.meta['caption']}", highlight=False, markup=False)
            else:
                console.print(_plain_table(made))
    if written:
        console.print(f"\n{len(written)} files in {written[0].parent}", highlight=False, markup=False)


def _plain_table(made: "AstropyTable") -> Table:
    table = Table(title=Text(made.meta["title"]))
    for name in made.colnames:
        numbers = made[name].dtype.kind in "fi"
        table.add_column(Text(name.replace("_", " ")), justify="right" if numbers else "left")
    for row in made:
        cells = ("" if value != value else value for value in row)
        table.add_row(*(f"{value:.3g}" if isinstance(value, float) else str(value) for value in cells))
    return table
