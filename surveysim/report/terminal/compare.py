"""A comparison of runs on the terminal."""

from pathlib import Path

from surveysim.report.terminal.layout import Terminal
from surveysim.report.terminal.survey import print_warnings, where_line
from surveysim.report.terminal.tables import show_table
from surveysim.runtime.numbers import plain
from surveysim.studies.compare.comparison import RunComparison
from surveysim.studies.compare.summary import comparison_summary
from surveysim.studies.compare.tables import difference_table, pairing_sentences, run_table, score_rows


def print_comparison(result: RunComparison, directory: Path | None) -> None:
    """Print the settings that differ, the runs, their scores, and where the files are, if there are any."""
    console, content = Terminal(160), comparison_summary(result)
    compared = content["compared"]
    settings = difference_table(compared)
    if settings is None:
        console.say("No setting differs.")
    for table in (settings, run_table(compared), score_rows(compared)):
        if table is not None:
            show_table(console, table)
    for sentence in pairing_sentences(compared):
        console.say(plain(sentence))
    print_warnings(console, content["warnings"])
    if directory is not None:
        console.say(f"\n{where_line(directory)}")
