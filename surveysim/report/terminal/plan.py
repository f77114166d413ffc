"""Plans of runs and sweeps on the terminal: stages, and predicted cost."""

from collections.abc import Mapping

from rich.table import Table
from rich.text import Text

from surveysim.report.terminal.layout import Terminal
from surveysim.scene.scene import Scene
from surveysim.studies.resources import Plan
from surveysim.studies.sweep.axes import Sweep
from surveysim.studies.sweep.bands import MultiBandSweep
from surveysim.studies.sweep.plan import SweepPlan


def print_plan(scene: Scene, plan: Plan, workers: int) -> None:
    """Print the stages, the omitted stages with reasons, and the predicted cost."""
    console = Terminal()
    table = Table(title=Text(f"{scene.name}: {scene.title}"))
    for heading in ("stage", "what"):
        table.add_column(heading)
    for name, what in plan.stages.items():
        table.add_row(name, what)
    for name, reason in plan.left_out.items():
        table.add_row(Text(name, style="dim"), Text(f"left out: {reason}", style="dim"))
    console.show(table)
    made = "one block of an observation" if "blocks" in plan.stages else "a few observations"
    solving = f" and {_seconds(plan.solution_s)} s to solve for the map" if plan.solution_s else ""
    lines = (
        f"about {_seconds(plan.wall_s)} s with {workers} worker(s), {_seconds(plan.figures_s)} s of it for figures"
        f"{solving}, predicted from {made} made here",
        f"about {plan.memory_bytes / 1e6:.0f} MB a process",
        f"about {plan.output_bytes / 1e6:.1f} MB of results",
        f"about {plan.timestream_bytes / 1e6:.0f} MB of time-streams, if saved",
        f"{plan.detector_samples / 1e6:.4g} million detector-samples",
    )
    console.say("\n".join(lines))


def _seconds(seconds: float) -> str:
    return f"{seconds:.1f}" if seconds < 10 else f"{seconds:.0f}"


def print_band_sweep_plans(sweep: MultiBandSweep, plans: Mapping[str, SweepPlan], workers: int) -> None:
    """Print the plan of each band's sweep, and the time of all."""
    for name, plan in plans.items():
        print_sweep_plan(sweep.bands[name], plan, workers)
    seconds = sum(plan.wall_s for plan in plans.values())
    Terminal().say(f"all {len(plans)} bands, one after another: about {seconds:.0f} s with {workers} worker(s)")


def print_sweep_plan(sweep: Sweep, plan: SweepPlan, workers: int) -> None:
    """Print the axes of a sweep and the predicted cost of its points."""
    console = Terminal(160)
    table = Table(title=Text(f"{sweep.name}: {plan.n_points} points"))
    table.add_column("axis")
    table.add_column("values")
    for axis in sweep.axes:
        table.add_row(Text(axis.name), Text(", ".join(axis.labels)))
    console.show(table)
    lines = (
        f"about {plan.wall_s:.0f} s with {workers} worker(s), predicted from the first and the last point",
        f"about {plan.memory_bytes / 1e6:.0f} MB a process",
        f"{plan.detector_samples / 1e6:.4g} million detector-samples",
    )
    console.say("\n".join(lines))
