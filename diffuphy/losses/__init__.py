"""What the scene is asked to look like and to do: score distillation, its schedules, and the priors that guide it."""

from diffuphy.losses.estimators import CSD, ISM, SDS, Estimator
from diffuphy.losses.schedules import Constant, Exponential, Linear, Schedule, Step
from diffuphy.losses.sds import score, sds

__all__ = ["CSD", "ISM", "SDS", "Constant", "Estimator", "Exponential", "Linear", "Schedule", "Step", "score", "sds"]
