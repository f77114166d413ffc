"""``python -m surveysim``: the command line."""

from surveysim.cli.main import main

main()
