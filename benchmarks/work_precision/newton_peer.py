"""Newton's implicit MPM (SolverImplicitMPM) on the problems of this benchmark, with the settings of its own examples.

    PYTHON newton_peer.py      # tasks come by standard input, see exchange.py

Elastic bodies as its example of a twisted beam has them, liquids as its dam break: incompressible. Steps are those of
the task, longer than explicit ones as far as the benchmark asks; every step solves for velocities and stresses
together. What is not the same: linear splines, walls that are half spaces of its colliders, another elastic law.
"""

import newton
import numpy as np
import warp as wp
from exchange import Runner, Task, serve
from newton.solvers import SolverImplicitMPM

STICKY = 1e6
"""Friction of a wall that holds [-]."""


class Implicit(Runner):
    """A task in Newton."""

    def __init__(self, task: Task):
        self.task = task
        builder = newton.ModelBuilder()
        SolverImplicitMPM.register_custom_attributes(builder)
        mass, radius = task.rho * task.vol, 0.5 * np.cbrt(task.vol)
        builder.add_particles(
            pos=[wp.vec3(*p) for p in task.x], vel=[wp.vec3(*p) for p in task.v], mass=mass.tolist(),
            radius=radius.tolist(),
        )  # fmt: skip
        for wall in task.walls:
            point, normal, kind, friction = wall[:3], wall[3:6], int(wall[6]), float(wall[7])
            cfg = newton.ModelBuilder.ShapeConfig(mu=(STICKY, 0.0, friction)[kind])
            plane = (*normal, -float(normal @ point))
            builder.add_shape_plane(plane=plane, width=0.0, length=0.0, cfg=cfg)
        self.model = builder.finalize(device="cpu")
        self.model.set_gravity(tuple(float(g) for g in task.gravity))
        material, solid = self.model.mpm, task.mu > 0
        config = SolverImplicitMPM.Config(voxel_size=task.dx)
        if solid:
            lam, mu = task.lam, task.mu
            material.young_modulus.fill_(mu * (3 * lam + 2 * mu) / (lam + mu))
            material.poisson_ratio.fill_(lam / (2 * (lam + mu)))
            material.tensile_yield_ratio.fill_(1.0)
            config.strain_basis, config.tolerance = "P1d", 1e-6
            config.carry_residual_strain, config.warmstart_mode = "unconverged", "particles"
            config.solver = "auto" if len(task.walls) else "cr"  # conjugate residuals know no contact
        else:
            material.friction.fill_(0.0)
            material.tensile_yield_ratio.fill_(1.0)
            config.max_iterations, config.tolerance, config.warmstart_mode = 50, 1e-3, "particles"
            config.collider_basis = "pic"
        self.solver = SolverImplicitMPM(self.model, config=config)
        self.states = [self.model.state(), self.model.state()]
        self.C = wp.array(task.C.astype(np.float32), dtype=wp.mat33, device="cpu")
        self.first = [wp.clone(a) for a in self.arrays(self.states[0])]

    @staticmethod
    def arrays(state: object) -> list[wp.array]:
        """What a step changes."""
        mpm = state.mpm
        return [state.particle_q, state.particle_qd, mpm.particle_elastic_strain, mpm.particle_Jp, mpm.particle_stress]

    def reset(self) -> None:
        for state in self.states:
            for array, first in zip(self.arrays(state), self.first, strict=True):
                array.assign(first)
            state.mpm.particle_qd_grad.assign(self.C)

    def frame(self) -> None:
        for _ in range(self.task.per):
            self.solver.step(self.states[0], self.states[1], None, None, self.task.dt)
            self.states.reverse()

    def positions(self) -> np.ndarray:
        return self.states[0].particle_q.numpy()


if __name__ == "__main__":
    wp.config.quiet = True
    wp.set_device("cpu")
    serve(Implicit)
