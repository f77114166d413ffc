"""Commands on a scene, or on the points of a sweep, before a run: check, optics."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from mapmaker.printable import say
from surveysim.cli.options import Overrides, SceneFile, bands_of, fail, ready_setup, sweep_of

if TYPE_CHECKING:
    from surveysim.reduction.setup import Setup
    from surveysim.scene.scene import Scene
    from surveysim.studies.sweep.axes import Sweep
    from surveysim.studies.sweep.bands import MultiBandSweep

NO_LOAD = "photon: found noise that follows from no load; 'photon.load' or a section [optics] is expected"


def check(scene: SceneFile, settings: Overrides = None) -> None:
    """Check a scene or sweep without running it.

    Each error is one line: file, key, the value found and the values allowed. Detectors are counted, and questionable
    choices are warned of; lines of a sweep name their points.
    """
    if sweep := sweep_of(scene, settings):
        large = _check_points(scene, sweep)
    elif scenes := bands_of(scene, settings):
        say(f"{scene}: {scenes.name!r} is a camera of {len(scenes.bands)} bands that can be run")
        large = _check_setups(scenes.bands)
    else:
        setup = ready_setup(scene, settings)
        knobs = _knobs(scene, settings) if setup.scene.optimise else ""
        say(f"{scene}: {setup.scene.name!r} is a scene that can be run")
        if knobs:
            say(f"'surveysim optimise' varies {knobs}")
        large = _check_setups({"": setup.scene})
    if large:
        say(large)


def _knobs(scene: Path, settings: list[str] | None) -> str:
    """Check the section [optimise] of a scene; return its knobs."""
    from surveysim.cli import options
    from surveysim.studies.optimise.problem import load_problem

    return ", ".join(knob.key for knob in load_problem(scene, options.settings(settings)).knobs)


def _check_setups(scenes: "Mapping[str, Scene]") -> str:
    """Count the detectors of each band and print warnings; return a line on the size of the whole."""
    from surveysim.reduction.resource_limits import said_of_size
    from surveysim.reduction.setup import prepare
    from surveysim.report.terminal.camera import camera_lines

    samples, pixels, warnings = 0, 0, []
    for name, scene in scenes.items():
        setup, before = prepare(scene), f"{name}: " if name else ""
        for line in camera_lines(setup):
            say(before + line)
        warnings += [before + line for line in _warnings(setup)]
        of_observation = setup.camera.n_det * setup.observing.samples(setup.observing.blocks[-1]).stop
        samples += scene.observations * of_observation
        pixels = setup.analysis.geometry.n_x * setup.analysis.geometry.n_y
    _say_warnings(warnings)
    return said_of_size(samples, pixels)


def _check_points(path: Path, sweep: "Sweep | MultiBandSweep") -> str:
    """Count the detectors of each point and print warnings; return a line on the size of the whole."""
    from surveysim.reduction.resource_limits import said_of_size
    from surveysim.report.terminal.camera import camera_lines
    from surveysim.studies.sweep.bands import sweep_points

    points = sweep_points(sweep)
    say(f"{path}: {sweep.name!r} is a sweep of {len(points)} points that can be run")
    counted, warned = _of_points(sweep, camera_lines, _warnings)
    for line in counted:
        say(line)
    _say_warnings(warned)
    return said_of_size(sum(point.detector_samples for point in points))


def _of_points(sweep: "Sweep | MultiBandSweep", *texts: "Callable[[Setup], Iterable[str]]") -> list[list[str]]:
    """Return the lines of each text about the points of a sweep, each once, after the points that it is about."""
    from surveysim.reduction.setup import prepare
    from surveysim.studies.sweep.bands import sweeps_of
    from surveysim.studies.sweep.point_names import name_of_points

    named: list[list[str]] = [[] for _ in texts]
    for band, item in sweeps_of(sweep).items():
        found: list[dict[str, list[int]]] = [{} for _ in texts]
        for point in item.points:
            setup = prepare(point.scene)
            for text, points in zip(texts, found, strict=True):
                for line in text(setup):
                    points.setdefault(line, []).append(point.number)
        for lines, points in zip(named, found, strict=True):
            before = f"{band}: " if band else ""
            lines += [f"{before}{name_of_points(item, numbers)}: {line}" for line, numbers in points.items()]
    return named


def _warnings(setup: "Setup") -> list[str]:
    from surveysim.reduction.design_warnings import design_warnings

    return [*design_warnings(setup), *_saturation(setup)]


def _saturation(setup: "Setup") -> list[str]:
    from surveysim.results.sensitivity import saturation_warnings, sensitivities

    detector = setup.scene.detector
    return saturation_warnings(sensitivities(setup)) if detector and detector.bolometer else []


def optics(scene: SceneFile, settings: Overrides = None) -> None:
    """Print the load and the sensitivity of a scene's detectors.

    The load by element, from the sky to the detector, and NEP, NET and NEFD at quartiles of the site's water. Each
    band has its own tables. A sweep has one, with a row for each point, at the median water.
    """
    from surveysim.reduction.setup import prepare

    if sweep := sweep_of(scene, settings):
        _print_optics_of_points(scene, sweep)
    elif scenes := bands_of(scene, settings):
        for name, item in scenes.bands.items():
            say(f"{name}:")
            _print_optics(scene, prepare(item))
    else:
        _print_optics(scene, ready_setup(scene, settings))


def _print_optics(path: Path, setup: "Setup") -> None:
    from surveysim.report.terminal.layout import Terminal
    from surveysim.report.terminal.tables import show_table
    from surveysim.results.sensitivity import (
        saturation_warnings,
        sensitivities,
        sensitivity_entries,
        sensitivity_tables,
    )
    from surveysim.telescope.diffraction import effective_area_m2

    found = sensitivities(setup)
    if not found:
        fail(f"{path}: {NO_LOAD}")
    entries, console = sensitivity_entries(setup, found), Terminal()
    for table in sensitivity_tables(entries):
        show_table(console, table)
    beam = math.degrees(setup.camera.focal_plane.fwhm_rad) * 3600
    say(f"beam of {beam:.4g} arcsec (FWHM); effective area of {effective_area_m2(setup.scene):.4g} m2")
    _say_warnings(saturation_warnings(found))


def _print_optics_of_points(path: Path, sweep: "Sweep | MultiBandSweep") -> None:
    from surveysim.report.terminal.layout import Terminal
    from surveysim.report.terminal.tables import show_table
    from surveysim.studies.sweep.bands import sweeps_of
    from surveysim.studies.sweep.sensitivities import sensitivity_of_points

    console = Terminal(160)
    for band, item in sweeps_of(sweep).items():
        table = sensitivity_of_points(item)
        if table is None:
            fail(f"{path}: {band}{': ' * bool(band)}{NO_LOAD}")
        show_table(console, table, title=": ".join(filter(None, (band, table.title))))
    _say_warnings(_of_points(sweep, _saturation)[0])


def _say_warnings(lines: Sequence[str]) -> None:
    for line in lines:
        say(f"Warning: {line}")
