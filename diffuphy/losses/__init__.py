"""What the scene is asked to look like and to do: score distillation, its schedules, and the priors that guide it."""

from diffuphy.losses.schedules import Constant, Exponential, Linear, Schedule
from diffuphy.losses.sds import sds

__all__ = ["Constant", "Exponential", "Linear", "Schedule", "sds"]
