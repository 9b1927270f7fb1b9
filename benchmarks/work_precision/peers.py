"""Other codes on the same problems: each a script of its own, run by an interpreter that has that code."""

import json
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from benchmarks.work_precision.choice import DEFAULT
from benchmarks.work_precision.exchange import WALL_KINDS, Task
from benchmarks.work_precision.problem import Problem, Sample, Trial

HERE = Path(__file__).parent


@dataclass(frozen=True)
class Code:
    """Another code."""

    series: str
    """Name in tables and figures."""
    family: str
    """What cases call it by."""
    script: str
    """File beside this one."""
    options: tuple[str, ...] = ()
    """Of the script."""
    package: str = ""
    """What its interpreter must have; the name that pip installs. Empty: it runs under that of this project."""
    force: str = "mls"
    """Where its forces come from."""
    cfl: float = 0.4
    """Its step for problems of explicit codes, in Δt (c + |v|)/Δx [-]."""
    most: int = 10**9
    """Steps beyond which a problem is left to others: an implicit one takes seconds on a processor."""


CODES = (
    Code("Taichi MLS-MPM", "taichi", "taichi_peer.py", ("f32",), "taichi"),
    Code("SVD a particle, stand-in", "svd", "svd_peer.py", force="classic"),
    Code("Newton implicit, CFL 2", "newton", "newton_peer.py", (), "newton", "implicit", 2.0, 20),
    Code("Newton implicit, CFL 8", "newton", "newton_peer.py", (), "newton", "implicit", 8.0, 20),
)
"""Everything that is compared with; see each script for what it is."""


@lru_cache
def room(problem: Problem) -> tuple[Tensor, Tensor]:
    """Corners of the box that the motion takes up, and three cells around it, by a run of the default: codes with a
    dense grid get the smallest that will do."""
    trial = Trial(problem, DEFAULT)
    trial.run()
    x = torch.stack([s.x.double() for s in trial.states]).flatten(0, 1)
    return x.amin(0) - 3 * problem.dx, x.amax(0) + 3 * problem.dx


def task_of(problem: Problem, cfl: float) -> Task:
    """The problem as arrays."""
    dt, per = problem.steps(cfl)
    b = problem.body
    N = len(b.x)
    lam, mu = b.lame
    liquid = b.elastic == "fluid_eos"
    lam, mu = (b.theta["bulk_modulus"], 0.0) if liquid else (lam, mu)
    zero = torch.zeros(N, 3, 3, dtype=torch.float64)
    walls = [[*w.point, *w.normal, float(WALL_KINDS.index(w.kind)), w.friction] for w in problem.walls]
    substeps = problem.frames * per
    forces = [problem.force(i * dt) for i in range(substeps)] if problem.force else []
    low, high = room(problem)
    return Task(
        x=b.x.numpy(), v=(zero[:, 0] if problem.v is None else problem.v).numpy(),
        C=(zero if problem.C is None else problem.C).numpy(), vol=b.vol.numpy(),
        law=b.elastic, mu=mu, lam=lam, gamma=b.theta.get("gamma", 0.0), rho=b.rho, dx=problem.dx, dt=dt, per=per,
        frames=problem.frames, gravity=np.array(problem.gravity), walls=np.array(walls).reshape(-1, 8),
        low=low.numpy(), high=high.numpy(),
        forces=torch.stack(forces).numpy() if forces else np.zeros((0, N, 3)),
    )  # fmt: skip


class Child:
    """A code in a process of its own.

    Raises:
        RuntimeError: the process ended; the message holds what it said last.
    """

    def __init__(self, code: Code, python: str, folder: Path):
        self.code, self.errors = code, (folder / f"{code.script}.log").open("w+")
        command = [python if code.package else sys.executable, str(HERE / code.script), *code.options]
        self.process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self.errors, text=True
        )

    def ask(self, order: str, path: Path) -> dict:
        assert self.process.stdin is not None and self.process.stdout is not None
        try:
            self.process.stdin.write(f"{order} {path}\n")
            self.process.stdin.flush()
        except BrokenPipeError:
            pass  # it ended; what it said is told below
        line = self.process.stdout.readline()
        while line and not line.startswith("{"):  # codes greet on standard output
            line = self.process.stdout.readline()
        if not line:
            self.process.wait()
            self.errors.seek(0)
            raise RuntimeError(f"{self.code.series} ended while asked to {order}: {self.errors.read()[-600:]}")
        return json.loads(line)

    def close(self) -> None:
        if self.process.stdin is not None:
            self.process.stdin.close()
        self.process.wait()
        self.errors.close()


class PeerTrial:
    """A problem in another code. A child holds one task at a time; it is told again whose turn it is."""

    loaded: dict[Child, "PeerTrial"] = {}  # noqa: RUF012, whose task each child holds

    def __init__(self, problem: Problem, child: Child, folder: Path):
        self.problem, self.child = problem, child
        task = task_of(problem, child.code.cfl)
        self.particles, self.rounds = len(task.x), task.per * task.frames
        self.path = Path(tempfile.mkdtemp(dir=folder)) / "task.npz"
        task.save(str(self.path))

    def run(self) -> Sample:
        """Play it; loading is not counted."""
        if self.loaded.get(self.child) is not self:
            self.child.ask("load", self.path)
            self.loaded[self.child] = self
        told = self.child.ask("run", self.path.with_name("positions.npy"))
        return Sample(told["seconds"], told["wall"])

    def error(self) -> float:
        """Of the last run [-]."""
        rows = np.load(self.path.with_name("positions.npy"))
        return self.problem.error(list(torch.from_numpy(rows))) if np.isfinite(rows).all() else float("nan")


def has(python: str, package: str) -> bool:
    """Whether an interpreter finds a package."""
    look = f"import importlib.util, sys; sys.exit(importlib.util.find_spec({package!r}) is None)"
    try:
        return subprocess.run([python, "-c", look], capture_output=True, check=False).returncode == 0
    except OSError:
        return False
