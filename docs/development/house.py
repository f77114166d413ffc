"""Measure the source tree: `python docs/development/house.py [COMMIT ...]` for commits and the work tree.

Counts packages, rows of the import contract, import circles, files of the main flow, lengths of files and functions,
docstrings that begin with a question word, broad error handlers, long positional signatures and words of the README.
"""

import ast
import io
import re
import subprocess
import sys
import tarfile
import tempfile
import tomllib
from collections import deque
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parent.parent.parent
PACKAGES = ("mapmaker", "surveysim")
QUESTIONS = ("What ", "How ", "Which ", "Where ")
MOST_POSITIONAL = 5
FACES = ("surveysim.api.public", "surveysim.api")  # the second in older commits
# Functions that the main flow passes through; some have another name in older commits.
MAIN_FLOW = {
    "scene": ("load_scene",),
    "setup": ("prepare",),
    "all observations": ("run_observations",),
    "one observation": ("observe",),
    "time-streams": ("draw_block",),
    "cleaning": ("apply_pipeline", "apply_recipe"),
    "co-adds": ("add_observation", "add_observations"),
    "scores": ("score_survey",),
    "results": ("survey_result",),
    "files": ("write_outputs",),
}
Function = ast.FunctionDef | ast.AsyncFunctionDef
Trees = dict[str, ast.Module]  # by the dotted name of the module


def main(commits: list[str]) -> None:
    """Print one column for each commit and one for the work tree."""
    columns = {commit: measured_commit(commit) for commit in commits} | {"work tree": measures(ROOT)}
    names = list(dict.fromkeys(name for column in columns.values() for name in column))
    print("| measure |", " | ".join(columns), "|")
    print("|---|" + "---:|" * len(columns))
    for name in names:
        print(f"| {name} |", " | ".join(column.get(name, "") for column in columns.values()), "|")


def measured_commit(commit: str) -> dict[str, str]:
    """Measure a commit, unpacked into a temporary folder."""
    archive = subprocess.run(["git", "archive", commit], cwd=ROOT, capture_output=True, check=True).stdout
    with tempfile.TemporaryDirectory() as folder, tarfile.open(fileobj=io.BytesIO(archive)) as file:
        file.extractall(folder, filter="data")
        return measures(Path(folder))


def measures(root: Path) -> dict[str, str]:
    """Measure the tree below `root`; values by the names of the measures."""
    paths = {module(path, root): path for package in PACKAGES for path in sorted((root / package).rglob("*.py"))}
    texts = {name: path.read_text(encoding="utf-8") for name, path in paths.items()}
    trees = {name: ast.parse(text) for name, text in texts.items()}
    imports = {name: imported(name, tree, trees, paths[name].name == "__init__.py") for name, tree in trees.items()}
    functions = [node for tree in trees.values() for node in ast.walk(tree) if isinstance(node, Function)]
    flow, missing = main_flow(trees, imports)
    tops = {name: {top(other) for other in others} for name, others in imports.items()}
    by_top: dict[str, set[str]] = {}
    for name, others in tops.items():
        by_top.setdefault(top(name), set()).update(others - {top(name)})
    docstrings = [text for tree in trees.values() for text in all_docstrings(tree)]
    long = [node for node in functions if n_positional(node) > MOST_POSITIONAL]
    entries = [path for path in (root / "surveysim").iterdir() if is_entry(path)]
    return {
        "entries at the top of surveysim/": f"{len(entries)}",
        "rows of the layers contract": f"{contract_rows(root)}",
        "import circles between modules": circles(imports),
        "import circles between packages": circles(by_top),
        "files of the main flow": f"{len(flow)}" + (f" (not found: {', '.join(missing)})" if missing else ""),
        "their lines": f"{sum(len(texts[name].splitlines()) for name in flow)}",
        "lines of a file: median / p90 / max": spread([len(text.splitlines()) for text in texts.values()]),
        "files": f"{len(texts)}",
        "lines of a function: median / p90 / max": spread([n_lines(node) for node in functions]),
        "functions": f"{len(functions)}",
        "docstrings that begin with What, How, Which or Where": f"{sum(t.startswith(QUESTIONS) for t in docstrings)}",
        "`except ValueError`": f"{sum(map(n_broad_handlers, trees.values()))}",
        "functions with more than 5 positional parameters": f"{sum(not is_kernel(node) for node in long)}",
        "the same, numba kernels": f"{sum(map(is_kernel, long))}",
        "words of the README": f"{len((root / 'README.md').read_text(encoding='utf-8').split())}",
    }


def module(path: Path, root: Path) -> str:
    """Name a module by its path."""
    parts = path.relative_to(root).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def top(name: str) -> str:
    """Name the entry at the top of its package that a module belongs to."""
    return ".".join(name.split(".")[:2])


def is_entry(path: Path) -> bool:
    """Tell a module, a package or a data file of the repository from what Python leaves behind."""
    return path.name != "__pycache__" and (path.is_file() or any(path.rglob("*.py")))


def contract_rows(root: Path) -> int:
    """Count the layers of surveysim in the contract of import-linter."""
    contracts = tomllib.loads((root / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    return sum(len(contract["layers"]) for contract in contracts if contract["type"] == "layers")


# ---------------------------------------------------------------- imports


def imported(name: str, tree: ast.Module, trees: Trees, is_package: bool) -> set[str]:
    """Find the modules that a module imports anywhere, but not those for type checkers alone."""
    found = set()
    for node in executed(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            above = name.split(".")[: len(name.split(".")) - node.level + is_package] if node.level else []
            base = ".".join([*above, *filter(None, [node.module])])
            found |= {full if (full := f"{base}.{alias.name}") in trees else base for alias in node.names}
    return (found & trees.keys()) - {name}


def executed(node: ast.AST) -> Iterator[ast.AST]:
    """Walk a tree without the branches that only type checkers read."""
    yield node
    if isinstance(node, ast.If) and ast.unparse(node.test).endswith("TYPE_CHECKING"):
        return
    for child in ast.iter_child_nodes(node):
        yield from executed(child)


def circles(graph: dict[str, set[str]]) -> str:
    """Count the groups of nodes that import each other, with the size of the largest."""
    reach = {node: reachable(graph, node) for node in graph}
    groups = {frozenset(b for b in reach[a] if a in reach.get(b, ())) for a in graph if a in reach[a]}
    return f"{len(groups)}" + (f" (largest: {max(map(len, groups))})" if groups else "")


def reachable(graph: dict[str, set[str]], start: str) -> set[str]:
    """Find the nodes that one or more steps lead to."""
    found, left = set(), [start]
    while left:
        new = graph.get(left.pop(), set()) - found
        found |= new
        left += new
    return found


def main_flow(trees: Trees, imports: dict[str, set[str]]) -> tuple[set[str], list[str]]:
    """Find the modules on the shortest import chains from the face to each step, and steps that are not found."""
    homes = {
        node.name: name
        for name, tree in trees.items()
        for node in tree.body
        if isinstance(node, Function) and any(node.name in names for names in MAIN_FLOW.values())
    }
    face = next(name for name in FACES if name in trees)
    flow, missing = {face}, []
    for step, names in MAIN_FLOW.items():
        home = next((homes[name] for name in names if name in homes), None)
        if home is None:
            missing.append(step)
        else:
            flow |= set(chain(imports, face, home))
    return flow, missing


def chain(graph: dict[str, set[str]], start: str, end: str) -> list[str]:
    """Find the nodes on a shortest path; the end alone if there is none."""
    before, left = {start: start}, deque([start])
    while left and end not in before:
        node = left.popleft()
        new = sorted(graph[node] - before.keys())
        before |= dict.fromkeys(new, node)
        left += new
    path = [end]
    while path[-1] in before and path[-1] != start:
        path.append(before[path[-1]])
    return path


# ---------------------------------------------------------------- functions and texts


def all_docstrings(tree: ast.Module) -> Iterator[str]:
    """Yield the docstrings of a module, its classes and its functions."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | Function):
            yield ast.get_docstring(node) or ""


def n_lines(node: Function) -> int:
    """Count the lines of a function without its docstring and decorators."""
    lines = node.end_lineno - node.lineno + 1
    if ast.get_docstring(node) is None:
        return lines
    return lines - (node.body[0].end_lineno - node.body[0].lineno + 1)


def n_positional(node: Function) -> int:
    """Count the parameters that a call may give by position, without self and cls."""
    names = [item.arg for item in (*node.args.posonlyargs, *node.args.args)]
    return len(names) - (names[:1] in (["self"], ["cls"]))


def is_kernel(node: Function) -> bool:
    """Tell functions compiled by numba, which has no keyword-only arguments."""
    return any(re.search(r"\b(n?jit|vectorize|kernel)\b", ast.unparse(item)) for item in node.decorator_list)


def n_broad_handlers(tree: ast.Module) -> int:
    """Count handlers of ValueError, alone or with others."""
    handlers = [node.type for node in ast.walk(tree) if isinstance(node, ast.ExceptHandler) and node.type]
    return sum(bool(re.search(r"\bValueError\b", ast.unparse(node))) for node in handlers)


def spread(values: list[int]) -> str:
    """Format median, 90th percentile and maximum."""
    ordered = sorted(values)
    return " / ".join(f"{ordered[round(share * (len(ordered) - 1))]}" for share in (0.5, 0.9, 1))


if __name__ == "__main__":
    main(sys.argv[1:])
