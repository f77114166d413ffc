"""The guide's examples, run as they stand."""

import os
import time
import tomllib
from concurrent.futures import ThreadPoolExecutor

import pytest

from tests.docs.pages import PAGES, README, Block, blocks, follow, with_sections

pytestmark = pytest.mark.docs
AT_ONCE = 2  # pages: much of each runs on one core
WITH_EXAMPLES = [path for path in (*PAGES, README) if any(block.language == "bash" for block in blocks(path))]


@pytest.fixture(scope="module")
def followed(request, tmp_path_factory):
    """Futures of the examples of each page that is asked for."""
    asked = [item.callspec.params["path"] for item in request.session.items if "followed" in item.fixturenames]
    with ThreadPoolExecutor(AT_ONCE) as pool:
        yield {path: pool.submit(follow, blocks(path), tmp_path_factory.mktemp(path.stem)) for path in asked}


@pytest.mark.parametrize("path", WITH_EXAMPLES, ids=lambda path: path.stem)
def test_page(path, followed):
    followed[path].result()


# ---------------------------------------------------------------- what follows a page


def page(*parts):
    return [Block("page.md", number, language, text) for number, (language, text) in enumerate(parts, 1)]


@pytest.mark.parametrize(
    ("wrong", "match"),
    [
        ([("bash", "true\nfalse\ntrue\n")], "page.md:1 ends with 1"),
        ([("bash", "false | cat\n")], "page.md:1 ends with 1"),
        ([("bash", "echo $NOTHING_OF_THIS_NAME\n")], "page.md:1 ends with"),
        ([("python", "print(1)\n")], "page.md:1: a script without a name"),
        ([("python", "# a.py\nraise SystemExit(3)\n"), ("bash", "python a.py\n")], "page.md:2 ends with 3"),
        ([("bash", "echo one\n"), ("text", "one\ntwo\n")], "page.md:2: not printed: two"),
        ([("diff", "--- a/README.md\n+++ b/README.md\n@@ -1 +1 @@\n-nothing\n+something\n")], "page.md:1 ends with"),
        ([("shell", "true\n")], "page.md:1: a block of kind 'shell'"),
    ],
)
def test_what_fails_is_noticed(wrong, match, tmp_path):
    with pytest.raises(AssertionError, match=match):
        follow(page(*wrong), tmp_path)


def test_a_block_that_fails_leaves_no_job_behind(tmp_path):
    with pytest.raises(AssertionError, match="page.md:1 ends with 1"):
        follow(page(("bash", "sleep 600 &\necho $! > job\nfalse\n")), tmp_path)
    with pytest.raises(ProcessLookupError):
        for _ in range(100):
            os.kill(int((tmp_path / "job").read_text()), 0)
            time.sleep(0.1)


def test_sections_take_the_place_of_those_of_their_name():
    scene = 'title = "a"  # b\nseed = 1\n\n[one]\nx = 1\n\n[one.part]\ny = 2\n\n[two]\nz = 3\n'
    changed = tomllib.loads(with_sections(scene, "seed = 2\n\n[one]\nx = 4\n\n[three]\nu = 5\n"))
    assert changed == {"title": "a", "seed": 2, "one": {"x": 4}, "two": {"z": 3}, "three": {"u": 5}}
    with pytest.raises(AssertionError, match="no key 'sead'"):
        with_sections(scene, "sead = 2\n")
