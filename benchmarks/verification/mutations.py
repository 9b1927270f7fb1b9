"""Does the suite bite? Known mistakes are put into a copy of the package, and the cases that should notice are run.

    python -m benchmarks.verification.mutations                    # all of them, a minute each
    python -m benchmarks.verification.mutations "PIC" "F (I + Δt L)"

Each is a mistake that published codes have made, or one that would be easy here. A mistake is caught when a case
leaves its interval or cannot be run at all; unchanged, the same cases pass.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


@dataclass(frozen=True)
class Mutation:
    """One mistake."""

    name: str
    file: str
    """In ``diffuphy``."""
    right: str
    """Text of the file, which must occur."""
    wrong: str
    """What it becomes, everywhere."""
    cases: tuple[str, ...]
    """Any of them must notice."""
    scheme: str = "default"


MUTATIONS = (
    Mutation(
        "first Piola–Kirchhoff stress for Kirchhoff's", "mpm/substep/kernels.py",
        "T = (-kick * vol[p] * idx) * tau",
        "T = (-kick * vol[p] * idx) * tau * wp.transpose(wp.inverse(F))",
        ("A4", "A7", "B1"),
    ),
    Mutation("F (I + Δt L)", "mpm/substep/kernels.py", "He_p += L + L * He_p", "He_p += L + He_p * L", ("A7h",)),
    Mutation(
        "PIC: the affine field is dropped", "mpm/substep/kernels.py", "C_out[t] = C_p", "C_out[t] = mat33()",
        ("A4", "B2"),
        "mls",
    ),
    Mutation(
        "retained velocity without its affine field", "mpm/substep/kernels.py",
        "            C_p += alpha * (C_0 - B_0)\n", "", ("A4",),
    ),
    Mutation(
        "Kirchhoff principal stresses times the stretches", "material/elastic/hencky.py",
        "return real(2.0) * mu * e + vec3(p, p, p)",
        "return wp.cw_mul(s, real(2.0) * mu * e + vec3(p, p, p))",
        ("A7",),
    ),
    Mutation(
        "bulk modulus where λ belongs", "material/elastic/neo_hookean.py",
        "p = lam * log_J",
        "p = (lam + real(2.0 / 3.0) * mu) * log_J",
        ("A7",),
    ),
    Mutation(
        "√(2/3) missing in von Mises", "material/plastic/von_mises.py", "root = real((2.0 / 3.0) ** 0.5)",
        "root = real(1.0)", ("E7",),
    ),
    Mutation(
        "viscosity read as twice what it is", "material/plastic/viscoplastic.py", "(mu * dt + theta[at_eta])",
        "(mu * dt + real(0.5) * theta[at_eta])", ("E7",),
    ),
    Mutation(
        "cubic splines with D = Δx²/4", "mpm/scheme.py", "return 0.25 if self.order == 2 else 1.0 / 3.0", "return 0.25",
        ("A4b",),
    ),
    Mutation(
        "friction stops the node", "mpm/boundary/kernels.py", "t = t * (real(1.0) - drag / length)", "t = vec3()",
        ("E6",), "mls",
    ),
    Mutation(
        "wall one node off", "mpm/boundary/layout.py", "(b.reach - SLACK +", "(b.reach - SLACK - 1.0 +", ("B3",), "mls"
    ),
    Mutation(
        "mirror one node off", "mpm/substep/mirror.py", "round(p / grid.dx - s) - o", "round(p / grid.dx - s) - o - 1",
        ("B3",),
    ),
    Mutation(
        "absolute number added to the mass of a node", "mpm/substep/nodes.py", "r[0] / m, r[1] / m, r[2] / m, m",
        "r[0] / (m + real(1e-9)), r[1] / (m + real(1e-9)), r[2] / (m + real(1e-9)), m", ("A1", "A3"),
    ),
    Mutation(
        "a full kick first", "mpm/span.py", "out[0, 1] = 0.5 * self.dt", "out[0, 1] = self.dt", ("A1",)
    ),
    Mutation(
        "indices that truncate towards zero", "mpm/substep/spline.py", "h = real(reach)\n        bx",
        "h = real(0.0)\n        bx", ("A1", "A2"),
    ),
    Mutation(
        "sharpening twice as strong", "mpm/scheme.py", "return SHARPENING[self.force, self.order] if self.sharpen",
        "return 2.0 * SHARPENING[self.force, self.order] if self.sharpen", ("B2",),
    ),
    Mutation(
        "adjoint of the stretches without that of their frame", "material/principal.py",
        "g = vec3(q[0] * G[1, 2]", "g = real(0.0) * vec3(q[0] * G[1, 2]", ("E2",),
    ),
    Mutation(
        "adjoint that divides by differences of stretches", "material/elastic/hencky.py", "if y < real(1e-3):",
        "if y < real(-1.0):", ("E2",),
    ),
    Mutation(
        "nodal gradients of the substep before are not cleared", "mpm/substep/nodes_adjoint.py",
        "bar[(scene * lanes + lane) * nodes + o - base] = node_t()",
        "bar[(scene * lanes + lane) * nodes + o - base] = bar[(scene * lanes + lane) * nodes + o - base]",
        ("E1", "E3"),
    ),
    Mutation(
        "gradient in the mass of a node dropped", "mpm/substep/nodes_adjoint.py",
        "node_t(q_bar[0], q_bar[1], q_bar[2], m_bar,", "node_t(q_bar[0], q_bar[1], q_bar[2], real(0.0),", ("E1",),
    ),
    Mutation(
        "replay from the wrong checkpoint", "mpm/engine/solver.py", "work.put(saved.pop())", "work.put(saved[0])",
        ("E5",),
    ),
    Mutation(
        "a cone of half the slope", "material/plastic/drucker_prager.py", "d = n + m.ratio(theta) * al * x",
        "d = n + real(0.5) * m.ratio(theta) * al * x", ("C6",),
    ),
    Mutation(
        "consistency read as twice what it is", "material/plastic/herschel_bulkley.py",
        "root2 * mu * dt / y) + wp.log(y / (root2 * theta[at_K]))",
        "root2 * mu * dt / y) + wp.log(y / (real(0.5) * root2 * theta[at_K]))", ("C5",),
    ),
    Mutation(
        "strength that forgets what has flowed", "material/plastic/von_mises_hardening.py",
        "line = root * (theta[at] + theta[at_H] * h[at_slip])", "line = root * theta[at]", ("C4b",),
    ),
    Mutation(
        "K for K/γ in the pressure of a liquid", "material/elastic/fluid_eos.py", "c = K / g", "c = K", ("C13",)
    ),
    Mutation(
        "partial flow once a substep", "mpm/rollout.py", "field.plastic, step, dt_ref)", "field.plastic, step, step)",
        ("C9",),
    ),
    Mutation(
        "unstable steps let through", "mpm/engine/clock.py", "T / math.ceil(T / self.dt) > limit",
        "T / math.ceil(T / self.dt) > 1e3 * limit", ("D3",),
    ),
)  # fmt: skip


def copied(folder: Path) -> None:
    """The package and its cases in ``folder``."""
    for name in ("diffuphy", "benchmarks/verification"):
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))


def apply(mutation: Mutation, folder: Path) -> None:
    """Put the mistake into the copy.

    Raises:
        ValueError: the text is not in the file: the solver has changed, and the mutation must follow it.
    """
    path = folder / "diffuphy" / mutation.file
    text = path.read_text(encoding="utf-8")
    if mutation.right not in text:
        raise ValueError(
            f"mutation {mutation.name!r}: {mutation.file} has no {mutation.right!r}; write the mistake in the words of "
            "the present file"
        )
    path.write_text(text.replace(mutation.right, mutation.wrong), encoding="utf-8")


def passes(cases: tuple[str, ...], scheme: str, folder: Path) -> bool:
    """Whether all cases stay within their intervals in ``folder``; kernels are built anew there."""
    command = [
        sys.executable,
        "-m",
        "benchmarks.verification",
        *cases,
        "--scheme",
        scheme,
        "--out",
        str(folder / "out"),
    ]
    place = {"PYTHONPATH": str(folder), "WARP_CACHE_PATH": str(folder / "cache")}
    done = subprocess.run(command, cwd=folder, env=os.environ | place, capture_output=True, check=False)
    return done.returncode == 0


def caught(mutation: Mutation) -> bool:
    """Whether one of its cases notices the mistake; the others are not run then."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        copied(folder)
        apply(mutation, folder)
        return any(not passes((case,), mutation.scheme, folder) for case in mutation.cases)


def unchanged() -> bool:
    """Whether the same cases pass without a mistake: else nothing is shown by one that fails."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        copied(folder)
        schemes = dict.fromkeys(m.scheme for m in MUTATIONS)
        cases = {s: dict.fromkeys(c for m in MUTATIONS if m.scheme == s for c in m.cases) for s in schemes}
        return all(passes(tuple(cases[s]), s, folder) for s in schemes)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", help="mutations; all if none is named")
    names = parser.parse_args().names
    if unknown := set(names) - {m.name for m in MUTATIONS}:
        parser.error(f"no mutation {min(unknown)!r}; known: {', '.join(repr(m.name) for m in MUTATIONS)}")
    survived = 0
    print(f"unchanged: {'passes' if unchanged() else 'FAILS; nothing below means anything'}", flush=True)
    for mutation in (m for m in MUTATIONS if not names or m.name in names):
        found = caught(mutation)
        survived += not found
        print(f"{'caught' if found else 'SURVIVED':<9} {mutation.name}  ({', '.join(mutation.cases)})", flush=True)
    return survived


if __name__ == "__main__":
    raise SystemExit(main())
