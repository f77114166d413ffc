"""The scene of studies that look at the actual data alone."""

from surveysim.scene.scene import Scene


def actual_alone(scene: Scene) -> Scene:
    """Leave out the data sets beside the actual one, which cost time; the actual data do not depend on them."""
    if scene.score is None:
        return scene
    score = scene.score.model_copy(update={"noise_only_sets": (), "mask_separation_f_lambda": None})
    return scene.model_copy(update={"score": score, "cleaning": scene.cleaning.model_copy(update={"compare": ()})})
