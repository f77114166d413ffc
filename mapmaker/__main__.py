"""``python -m mapmaker``: the command line."""

from mapmaker.cli.main import main

main()
