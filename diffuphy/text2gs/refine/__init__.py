"""Refine a prompt: from a sentence to the words that the later stages act on."""

from diffuphy.text2gs.refine.hosted import OpenAI
from diffuphy.text2gs.refine.local import Transformers
from diffuphy.text2gs.refine.loop import Refined
from diffuphy.text2gs.refine.pictures import Clip, Diffusion
from diffuphy.text2gs.refine.protocols import ImageGenerator, Picture, Refinement, Refiner, Scorer, Unavailable
from diffuphy.text2gs.refine.replay import Recording, Replay
from diffuphy.text2gs.refine.rules import Rules

__all__ = [
    "Clip",
    "Diffusion",
    "ImageGenerator",
    "OpenAI",
    "Picture",
    "Recording",
    "Refined",
    "Refinement",
    "Refiner",
    "Replay",
    "Rules",
    "Scorer",
    "Transformers",
    "Unavailable",
]
