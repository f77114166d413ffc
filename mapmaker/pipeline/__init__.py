"""From time-stream files to maps: what `mapmaker clean-and-map` does, file by file."""
