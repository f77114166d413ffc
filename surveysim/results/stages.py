"""Stages of a run, and stages left out with their reasons."""

from surveysim.reduction.data_set import scaled_name
from surveysim.reduction.setup import Setup, signal_sim_observations
from surveysim.runtime.numbers import joined
from surveysim.scene.scene import Scene
from surveysim.telescope.scans import samples_per_scan
from surveysim.timestreams.component import COMPONENTS, present_components
from surveysim.timestreams.response import present_steps

# Optional sections, and the consequence of leaving each out.
OPTIONAL = {item.name: item.absence for item in COMPONENTS if item.absence is not None} | {
    "score": ": no map PSDs, no sign-flipped maps"
}


def absent_sections(scene: Scene) -> list[str]:
    """List the optional sections that the scene does not have."""
    return [name for name in OPTIONAL if getattr(scene, name) is None]


def stages_that_run(setup: Setup) -> dict[str, str]:
    """Return every stage of a run of the scene with its description."""
    scene = setup.scene
    scans = f"{scene.observations} observations of {setup.observing.scans.n_scans} scans"
    stages = {"pointing": f"{scans}, {setup.camera.n_det} detectors, {scene.scan.sample_rate_hz:g} Hz"}
    if len(setup.observing.blocks) > 1:
        most = max(block.n_scans for block in setup.observing.blocks)
        megabytes = (
            most * samples_per_scan(setup.observing.scans) * setup.camera.n_det * setup.stream_type.itemsize / 1e6
        )
        stages["blocks"] = (
            f"{len(setup.observing.blocks)} an observation, {most} scans or fewer in {megabytes:.3g} MB of streams"
        )
    stages |= {item.name: item.sentence for item in present_components(scene)}
    stages |= {step.name: step.sentence for step in present_steps(setup) if step.section != "instrument"}
    stages["cleaning"] = ", ".join(pipeline.label for pipeline in setup.analysis.whole_pipelines)
    stages["maps"] = f"{setup.analysis.geometry.n_x} x {setup.analysis.geometry.n_y} pixels{_maker(scene)}"
    if scene.score:
        n_with_sims = int(signal_sim_observations(scene).sum())
        stages["data sets"] = ", ".join([*setup.analysis.data_set_names, *map(scaled_name, _masked(setup))])
        stages["transfer function"] = f"{scene.score.signal_sims.skies} skies through {n_with_sims} observations"
        if setup.analysis.own_sky is not None:
            stages["sky in and out"] = f"the scene's sky through the same {n_with_sims} observations, without noise"
        stages["score"] = f"multipoles {scene.score.ell_min} to {scene.score.ell_max}"
        if scene.spectra:
            counts = [f"{split.name} ({len(split.parts)} parts)" for split in setup.analysis.splits.splits]
            stages["spectra"] = f"cross-spectra and null tests of splits by {joined(counts)}"
        if _why_no_forecast(setup) is None:
            stages["forecast"] = "closed form, for each data set"
    if scene.map.healpix_nside:
        stages["HEALPix"] = f"maps at nside {scene.map.healpix_nside}"
    return stages


def _why_no_forecast(setup: Setup) -> str | None:
    """Say why a scene with a score has no forecast; None if it has one."""
    from surveysim.forecasting.forecast import why_no_forecast

    return why_no_forecast(setup)


def _maker(scene: Scene) -> str:
    """Say what maps are made by, where they are not binned."""
    section = scene.map
    if section.maker == "destriped":
        return f", destriped with baselines of {section.destriped.baseline_s:g} s"
    if section.maker == "maximum_likelihood":
        return (
            f", of maximum likelihood with the noise in {len(section.likelihood.band_edges_hz) + 1} bands of frequency"
        )
    return f", in up to {section.iteration.max_passes} passes over the survey" if section.maker == "iterative" else ""


def _masked(setup: Setup) -> list[str]:
    return [pipeline.data_set for pipeline in setup.analysis.pipelines if pipeline.detectors is not None]


def left_out(setup: Setup) -> dict[str, str]:
    """Return every stage that a run of the scene leaves out with its reason."""
    scene = setup.scene
    reasons = {name: f"no section [{name}]{OPTIONAL[name]}" for name in absent_sections(scene)}
    switched = (item for item in COMPONENTS if getattr(scene, item.name) and not item.is_present(scene))
    reasons |= {item.name: f"{item.name}.{item.switch} is 'none'" for item in switched}
    if scene.fixed_pointing:
        reasons["ephemerides"] = "a fixed elevation needs none"
    if setup.air.water is None:
        reasons["opacity"] = "no atmosphere.site"
    if not any(section and section.coherence != "none" for section in (scene.photon, scene.excess)):
        reasons["overlap"] = "no noise that is common to detectors"
    if scene.others and not setup.others:
        reasons["other bands"] = "no pipeline subtracts them"
    if scene.score is None:
        reasons |= dict.fromkeys(("transfer function", "forecast", "best pipeline"), "no section [score]")
    elif reason := _why_no_forecast(setup):
        reasons["forecast"] = reason
    if scene.score and not setup.analysis.chooses:
        reasons["best pipeline"] = "no cleaning.compare"
    if not scene.map.healpix_nside:
        reasons["HEALPix"] = "no map.healpix_nside"
    return reasons
