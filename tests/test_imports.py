"""Who may import whom. The architecture is this table."""

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "diffuphy"
FILES = sorted(PACKAGE.rglob("*.py"))

MAY_IMPORT = {
    "types": set(),
    "workspace": set(),
    "geometry": set(),
    "compiling": set(),
    "quoting": set(),
    "artifact": {"workspace"},
    "models": set(),
    "losses": {"types", "models"},
    "metrics": {"types", "models", "geometry"},
    "material": {"types", "compiling"},
    "render": {"types", "workspace", "geometry", "compiling", "material"},
    "mpm": {"types", "workspace", "geometry", "compiling", "material"},
    "physgaussian": {"material", "mpm", "render", "text2gs"},
    "convert": {"physgaussian"},
    "text2gs": {"types", "workspace", "geometry", "compiling", "render", "losses", "models"},
    "learning": {"types", "workspace", "geometry", "render", "material", "mpm", "losses"},
    "rivals": {"types", "workspace", "material", "mpm", "losses", "metrics", "physgaussian", "learning"},
    "errors": {"types", "workspace", "mpm", "render"},
    "shots": {"types", "workspace", "render"},
    "evaluate": {"types", "workspace", "material", "mpm", "render", "metrics", "shots"},
    "accuracy": {"types", "material"},
    "cost": {"types", "material", "mpm", "learning"},
    "plan": {"types", "artifact", "material", "accuracy", "cost"},
    "pipeline": {"types", "artifact", "plan", "metrics", "render"},
    "judgement": {"types", "artifact", "render"},
    "scorecard": {"artifact", "render", "metrics"},
    "formats": {"types", "render", "geometry", "composing"},
    "deliverables": {"types", "artifact", "plan", "render", "judgement", "scorecard", "formats"},
    "export": {"formats"},
    "explain": set(),
    "settings": set(),
    "composing": {"quoting"},
    "making": {"quoting", "composing", "settings", "artifact", "plan", "pipeline", "deliverables", "formats", "viewer"},
    "cli": {"quoting", "explain", "composing", "making", "artifact", "judgement", "scorecard"},
    "doctor": {"models", "compiling", "composing"},
    "viewer": {"types", "workspace", "geometry", "formats", "material", "mpm", "render", "accuracy"}
    | {"explain", "composing"},
    "__init__": {"making"},
    "__main__": {"cli"},
}
"""``artifact`` and ``losses`` know no physics, ``material`` knows no simulation, and ``pipeline`` knows no stage: they
meet in the configuration."""

HEAVY = {
    "accelerate": (),
    "diffusers": ("losses/guidance/", "text2gs/refine/"),
    "gsplat": ("render/",),
    "huggingface_hub": ("losses/guidance/", "metrics/", "text2gs/refine/"),
    "imageio_ffmpeg": ("render/",),
    "lpips": ("metrics/",),
    "matplotlib": (),
    "open_clip": ("metrics/", "losses/guidance/", "text2gs/refine/"),
    "openai": ("text2gs/refine/",),
    "torchmetrics": ("metrics/",),
    "torchvision": ("losses/", "metrics/"),
    "transformers": ("losses/guidance/", "metrics/", "text2gs/refine/"),
    "trimesh": ("text2gs/", "formats/"),
    "viser": ("formats/", "viewer/"),
}
"""Packages that cost seconds or are optional: imported inside functions, and only in these places."""


def imports(tree: ast.AST, path: Path) -> Iterator[str]:
    """Every module a syntax tree imports, by its absolute name."""
    package = ["diffuphy", *path.relative_to(PACKAGE).parent.parts]
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) + 1 - node.level] if node.level else []
            module = ".".join([*base, node.module] if node.module else base)
            yield module
            yield from (f"{module}.{alias.name}" for alias in node.names)


def module_level(tree: ast.Module) -> ast.Module:
    """The statements that run at import: everything outside functions."""

    class Strip(ast.NodeTransformer):
        def visit_FunctionDef(self, node: ast.FunctionDef) -> None:
            return None

        visit_AsyncFunctionDef = visit_FunctionDef

    return Strip().visit(tree)


def unit(path: Path) -> str:
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_imports_go_one_way(path):
    here = unit(path)
    assert here in MAY_IMPORT, f"{here} has no line in the table: say what it may import"
    siblings = {unit(p) for p in FILES}
    for name in imports(ast.parse(path.read_text(encoding="utf-8")), path):
        parts = name.split(".")
        if parts[0] == "diffuphy" and len(parts) > 1 and parts[1] in siblings and parts[1] != here:
            assert parts[1] in MAY_IMPORT[here], f"{path.relative_to(ROOT)} imports diffuphy.{parts[1]}"


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_heavy_packages_stay_in_their_backend(path):
    tree = ast.parse(path.read_text(encoding="utf-8"))
    where = path.relative_to(PACKAGE).as_posix()
    everywhere = {name.split(".")[0] for name in imports(tree, path)}
    for package in everywhere & set(HEAVY):
        assert where.startswith(HEAVY[package]), f"{where} imports {package}, which belongs to {HEAVY[package]}"
    at_import = {name.split(".")[0] for name in imports(module_level(tree), path)}
    assert not at_import & set(HEAVY), f"{where} imports {sorted(at_import & set(HEAVY))} at module level"


def loaded_after(statement: str, *packages: str) -> list[str]:
    """Which of ``packages`` a fresh interpreter has loaded after ``statement``."""
    code = f"{statement}\nimport sys\nprint(*(p for p in {packages!r} if p in sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    return done.stdout.split()


def test_importing_the_package_loads_nothing_heavy():
    assert loaded_after("import diffuphy", "torch", "warp", "numpy", "hydra", *HEAVY) == []


def test_importing_the_command_line_loads_no_torch():
    assert loaded_after("import diffuphy.cli", "torch", "warp", "numpy", "scipy", *HEAVY) == []


def test_importing_the_pipeline_loads_no_backend():
    """The embedded prior answers without diffusers, transformers and the like."""
    assert loaded_after("import diffuphy.pipeline", *HEAVY) == []
