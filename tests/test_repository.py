"""The rules of the house, kept by tests: sizes, names, what a tracked file must not say."""

import ast
import re
import subprocess
import tomllib
from pathlib import Path

import pytest

import diffuphy

ROOT = Path(__file__).parents[1]
PACKAGE = sorted((ROOT / "diffuphy").rglob("*.py"))
TEXT = {".py", ".md", ".toml", ".txt", ".yaml", ".yml", ".cff", ".sh", ".json", ".cfg", ".ini", ""}


def tracked() -> list[Path]:
    """Files of the repository; of the source archive, all files outside hidden folders."""
    try:
        listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
        files = [ROOT / line for line in listed.splitlines()]
    except (OSError, subprocess.CalledProcessError):
        files = [p for p in ROOT.rglob("*") if not any(part.startswith(".") for part in p.relative_to(ROOT).parts)]
    return [p for p in files if p.is_file() and p.suffix in TEXT]


def name(path: Path) -> str:
    return str(path.relative_to(ROOT))


@pytest.mark.parametrize("path", PACKAGE, ids=name)
def test_file_is_short(path):
    assert len(path.read_text(encoding="utf-8").splitlines()) <= 300


@pytest.mark.parametrize("path", PACKAGE, ids=name)
def test_functions_are_short(path):
    """At most 60 lines of body; signature, docstring and nested functions not counted."""
    function = ast.FunctionDef | ast.AsyncFunctionDef
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, function):
            body = node.body[1:] if ast.get_docstring(node) else node.body
            lines = {n for part in body for n in range(part.lineno, part.end_lineno + 1)}
            for part in ast.walk(node):
                if isinstance(part, function) and part is not node:
                    lines -= set(range(part.lineno, part.end_lineno + 1))
            assert len(lines) <= 60, f"{name(path)}: {node.name} has {len(lines)} lines"


@pytest.mark.parametrize("path", PACKAGE, ids=name)
def test_module_says_what_it_is(path):
    assert ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))), f"{name(path)} has no docstring"


def test_no_file_is_named_after_nothing():
    vague = {"utils", "util", "helpers", "helper", "misc", "manager", "wrapper", "common", "data"}
    assert [name(p) for p in PACKAGE if vague & set(p.relative_to(ROOT).with_suffix("").parts)] == []


@pytest.mark.parametrize("path", PACKAGE, ids=name)
def test_nothing_is_unpickled_and_no_error_is_hidden(path):
    """Results and weights are data, never code; NaN and bare exceptions are never swept away."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        where = f"{name(path)}:{getattr(node, 'lineno', 0)}"
        if isinstance(node, ast.Import | ast.ImportFrom):
            names = {a.name for a in node.names} | {getattr(node, "module", None)}
            assert not names & {"pickle", "dill", "cloudpickle", "joblib"}, where
        elif isinstance(node, ast.ExceptHandler):
            assert node.type is not None, f"{where}: except without a class"
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            call, keywords = ast.unparse(node.func), {k.arg: ast.unparse(k.value) for k in node.keywords}
            assert call != "torch.load" or keywords.get("weights_only") == "True", f"{where}: torch.load unpickles"
            assert call not in {"np.load", "numpy.load"} or "allow_pickle" not in keywords, (
                f"{where}: np.load unpickles"
            )
            assert not node.func.attr.startswith("nan_to_num"), f"{where}: {call} hides what went wrong"


def test_no_file_names_a_machine():
    """No path of somebody's machine, no package index: the project speaks of itself alone."""
    private = re.compile(
        r"/(?:work|tmp|root|Users|home/\w+)/|find-links|--(?:extra-)?index-url|pypi\.org|pythonhosted|localhost:\d"
    )
    found = []
    for path in tracked():
        if path == Path(__file__):
            continue
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
            if private.search(line):
                found.append(f"{name(path)}:{number}: {line.strip()[:100]}")
    assert not found, "\n".join(found)


def test_constraints_hold_names_and_versions_only():
    """``name==version ; marker`` on every line: no host, no option, no local build such as ``2.0+cpu``."""
    line = re.compile(r"[A-Za-z0-9][\w.-]*==[\w.]+( ; [\w\s.*'\"()<>=!]+)?")
    text = (ROOT / "constraints.txt").read_text(encoding="utf-8")
    assert [entry for entry in text.splitlines() if not line.fullmatch(entry)] == []


def test_constraints_pin_every_requirement():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    wanted = [*project["dependencies"], *(r for extra in project["optional-dependencies"].values() for r in extra)]
    normal = {re.sub(r"[-_.]+", "-", re.match(r"[\w.-]+", r)[0]).lower() for r in wanted} - {"diffuphy"}
    pinned = {
        entry.split("==")[0].lower() for entry in (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    }
    assert normal - pinned == set(), "run: make constraints"


def test_python_versions_agree():
    pyproject = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    assert pyproject["project"]["requires-python"] == ">=3.11"
    assert pyproject["tool"]["ruff"]["target-version"] == "py311"
    assert "3.11" in (ROOT / "README.md").read_text(encoding="utf-8")


def test_version_is_in_the_changelog_and_the_citation():
    assert f"## {diffuphy.__version__}" in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert f"version: {diffuphy.__version__}" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")


@pytest.mark.parametrize("page", [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))], ids=name)
def test_documented_commands_exist(page):
    """Every ``make TARGET``, file and documented path that a page tells the reader to use is there."""
    text = page.read_text(encoding="utf-8")
    targets = set(re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), flags=re.MULTILINE))
    blocks = "\n".join(re.findall(r"^```(?:bash|console|sh)\n(.*?)^```", text, flags=re.MULTILINE | re.DOTALL))
    assert set(re.findall(r"\bmake ([a-z]+)", blocks)) <= targets
    for script in re.findall(r"python ([\w/]+\.py)", blocks):
        assert (ROOT / script).exists(), script
    for link in re.findall(r"\]\((?!https?:|#|mailto:)([^)#]+)", text):
        assert (page.parent / link).exists(), f"{name(page)} links to {link}"


@pytest.mark.parametrize("page", [ROOT / "README.md", ROOT / "docs/cli.md"], ids=name)
def test_documented_settings_exist(page):
    """Every ``group=option`` after ``train.py`` or ``diffuphy`` in a page is an option of conf/."""
    text = page.read_text(encoding="utf-8")
    for line in re.findall(r"^(?:python train\.py|diffuphy) (.*)$", text, flags=re.MULTILINE):
        for group, option in re.findall(r"(?<!\S)(\w+)=(\w+)", re.sub(r"#.*| prompt=(\"[^\"]*\"|\S+)", "", " " + line)):
            if (ROOT / "conf" / group).is_dir():
                assert (ROOT / "conf" / group / f"{option}.yaml").exists(), f"{group}={option}"
