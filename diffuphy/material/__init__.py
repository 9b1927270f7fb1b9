"""What things are made of: constitutive laws, their mixtures, and presets in SI units.

ELASTIC, PLASTIC    the laws, by name; the order is the index in checkpoints
make_mixture        Warp functions of a mixture: stress, return map, closed-form adjoint
wave_speed          what bounds the time step
kirchhoff, energy, return_map, remember     a law at a material point, on torch tensors, differentiable
PRESETS, lookup     material words ("rubber", "sand") as laws and parameters
"""

from .elastic import ELASTIC
from .expert import Elastic, Layout, Param, Plastic
from .mixture import Mixture, make_mixture, rate_gate, wave_speed
from .plastic import PLASTIC
from .point import energy, kirchhoff, remember, return_map
from .preset import Preset
from .presets import PRESETS, candidates, lookup

__all__ = [
    "ELASTIC",
    "PLASTIC",
    "PRESETS",
    "Elastic",
    "Layout",
    "Mixture",
    "Param",
    "Plastic",
    "Preset",
    "candidates",
    "energy",
    "kirchhoff",
    "lookup",
    "make_mixture",
    "rate_gate",
    "remember",
    "return_map",
    "wave_speed",
]
