"""Convergence of maps that are not simply binned: what is told of it, and warnings."""

from typing import Any

from surveysim.scene.scene import Scene
from surveysim.survey.coadds import CoAdds


def map_maker_entry(scene: Scene, coadds: CoAdds) -> dict[str, Any]:
    """Return the map-maker and the convergence of its maps, as summary.json has them."""
    return {"maker": scene.map.maker, "convergence": [vars(item) for item in coadds.convergence]}


def convergence_warnings(scene: Scene, coadds: CoAdds) -> list[str]:
    """Return a line for each map that has not converged."""
    maker = scene.map.maker
    return [
        f"{item.name}: the {maker.replace('_', '-')} map has not converged after {item.iterations} iterations, its"
        f" residual is {item.residual:.2g}; its score can't be trusted. Remedy: a larger map.{maker}.max_iterations"
        for item in coadds.convergence
        if not item.converged
    ]
