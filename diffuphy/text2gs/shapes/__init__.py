"""Procedural library of objects as signed distances: what the analytic prior knows, and where initial points come
from."""

from diffuphy.text2gs.shapes.catalogue import RECIPES, find
from diffuphy.text2gs.shapes.library import Library
from diffuphy.text2gs.shapes.primitives import Part, Recipe
from diffuphy.text2gs.shapes.shape import Shape

__all__ = ["RECIPES", "Library", "Part", "Recipe", "Shape", "find"]
