"""The motion as arrays, for whoever goes on from there."""

import json
from pathlib import Path

import numpy as np

from diffuphy.formats.options import Options
from diffuphy.formats.run import Run

UNITS = {
    "x": "m; positions of N particles in T frames, (T, N, 3)",
    "v": "m/s; velocities, (T, N, 3)",
    "F": "-; total deformation gradients, (T, N, 3, 3)",
    "Fe": "-; their elastic part, (T, N, 3, 3); absent where nothing flows: it is F then",
    "volume": "m^3; at rest, (N,)",
    "density": "kg/m^3; at rest, (N,)",
    "gaussian": "index of the Gaussian that a particle carries, -1 inside, (N,)",
    "time": "s; of each frame, (T,)",
    "follows": "particles that each of G Gaussians follows, (G, k)",
    "share": "-; and how much of each, rows sum to 1, (G, k)",
    "arm": "m; from particle to Gaussian at rest, (G, k, 3)",
    "quats": "orientations of the Gaussians at rest, wxyz, (G, 4)",
    "scales": "m; their standard deviations at rest, (G, 3)",
    "opacities": "-; in [0, 1], (G,)",
    "sh": "colour coefficients in the 3DGS basis, (G, (degree + 1)^2, 3)",
}
"""Every array of the file: unit, meaning, shape. A Gaussian is at the sum over k of share (x[follows] +
F[follows] arm), with covariance F A F^T."""

AROUND = {
    "around_means": "m; places of S Gaussians that stand around the object and do not move, (S, 3)",
    "around_quats": "their orientations, wxyz, (S, 4)",
    "around_scales": "m; their standard deviations, (S, 3)",
    "around_opacities": "-; in [0, 1], (S,)",
    "around_sh": "colour coefficients in the 3DGS basis, (S, (degree + 1)^2, 3)",
}
"""The same of what stands around the object; absent where nothing does."""


def npz(run: Run, options: Options) -> list[Path]:
    """``trajectory.npz``: ``UNITS`` says what is in it, as does its own entry ``about`` (JSON). z is up, metres."""
    motion, particles, skin = run.trajectory, run.particles, run.skin
    chosen = options.frames(len(motion.x))
    arrays = {
        "x": motion.x[chosen],
        "v": motion.v[chosen],
        "F": motion.F[chosen],
        **({} if motion.Fe is None else {"Fe": motion.Fe[chosen]}),
        "volume": particles.vol,
        "density": run.field.rho,
        "gaussian": particles.gaussian,
        "follows": skin.index,
        "share": skin.weight,
        "arm": skin.arm,
        "quats": skin.gaussians.quats,
        "scales": skin.gaussians.log_scales.exp(),
        "opacities": skin.gaussians.logit_opacities.sigmoid(),
        "sh": skin.gaussians.sh,
    }
    units = UNITS
    if options.around and (g := run.still) is not None:
        values = (g.means, g.quats, g.log_scales.exp(), g.logit_opacities.sigmoid(), g.sh)
        arrays |= dict(zip(AROUND, values, strict=True))
        units = UNITS | AROUND
    about = {"title": run.title, "comment": run.comment(), "axes": "right-handed, z up", "arrays": units}
    file = options.folder / "trajectory.npz"
    np.savez_compressed(
        file,
        about=np.array(json.dumps(about, ensure_ascii=False)),
        time=np.array(chosen) / motion.fps,
        **{name: value.numpy() for name, value in arrays.items()},
    )
    return [file]
