"""Names of the files that commands write."""

import re

NEW = ".surveysim.new"  # begins the name of a temporary folder of results
# The scene, and the tables that its keys of files name, with the suffix of the user's file.
_TABLES = (
    "positions|passband|illumination|transmission|emissivity|opacity|spectrum|track_table|weather_table|map_file"
    "|catalogue_file"
)
_SCENE = rf"scene\.toml|({_TABLES})(_\d+)?(\.[\w-]+)?"
# Names that any command writes: no other file is ever removed, even if the record lists it.
WRITTEN = re.compile(
    rf"{_SCENE}|"
    r"report\.html|(summary|scene)\.json|checkpoint\.h5|bright_sky\.npz|extremes\.ecsv"
    r"|(sweep|sweep_pairs|forecast|accuracy|bands|spectra|spectra_windows)\.ecsv|spectra\.sacc|table\d+(_[a-z]+)?\.ecsv|figure\d+\.(png|ecsv)"
    r"|explain\.ecsv|second_layer\.(ecsv|png)|observations_\w+\.ecsv"
    r"|(measurements|recovered)_[0-9]+\.ecsv|tables/\w+\.ecsv|maps/\w[\w.+~,=-]*\.fits|figures/\w+\.png"
    r"|timestreams/\d+\.h5|noise_weights/\d+\.npz|scores\.npz|points/\d+(_\d+)?\.npz|points/\d+\.checkpoint\.h5|evaluations\.jsonl"
    r"|points/\d+\.bright_sky\.npz|points/\d+\.noise_weights/\d+\.npz"
)
SAYS_ITSELF = re.compile(  # they name their scene
    r"checkpoint\.h5|bright_sky\.npz|points/\d+(_\d+)?\.npz|points/\d+\.(checkpoint\.h5|bright_sky\.npz)"
    r"|evaluations\.jsonl"
)
UNFINISHED_WORK = re.compile(rf"{SAYS_ITSELF.pattern}|timestreams/\d+\.h5|noise_weights/(\d+\.npz|skies_\d+\.npy)")
INPUT = re.compile(_SCENE)
