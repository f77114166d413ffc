"""``python -m surveysim``: the command line."""

from surveysim.main import main

main()
