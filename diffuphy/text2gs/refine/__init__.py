"""Refine a prompt: from a sentence to the words that the later stages act on."""

from diffuphy.text2gs.refine.rules import Rules

__all__ = ["Rules"]
