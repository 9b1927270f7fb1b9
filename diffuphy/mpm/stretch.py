"""How much of the total deformation of flowing matter is kept.

A liquid shears without end, and a drop that slides over a floor is sheared the more the longer it slides: its total
deformation gradient grows exponentially and leaves float32 within seconds. Nothing pushes with it, it only says how
what rides on the matter is drawn out; and from a stretch of 1/ε on no digit of any other axis is left in it. So from
there on its size stands, and its direction is carried on:

    F ← F · min(1, LONGEST/|F|)        at the end of a frame
"""

import dataclasses

import torch

from diffuphy.mpm.state import State

LONGEST = 2.0**23
"""Largest |F| that is kept [-]: 1/ε of float32, in which films are stored."""


def bounded(state: State) -> State:
    """The state with |F| ≤ LONGEST where matter flows; the very same where nothing is longer. Differentiable."""
    if state.H is None:
        return state
    F = state.F
    longest = float(F.detach().abs().max())
    if not longest > LONGEST / 3:  # |F| ≤ 3 max |F_ij|; what is not finite is not hidden here
        return state
    scale = F.detach().abs().amax((1, 2), keepdim=True).clamp_min(1.0)  # so that no square overflows
    norm = scale * torch.linalg.matrix_norm(F / scale, keepdim=True)
    too_long = norm > LONGEST
    eye = torch.eye(3, dtype=F.dtype, device=F.device)
    return dataclasses.replace(state, H=torch.where(too_long, F * (LONGEST / norm) - eye, state.H))
