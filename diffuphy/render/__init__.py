"""Rendering of Gaussians: rasterisers, colours, cameras, the skin that ties them to particles, and the film."""

from diffuphy.render.cameras import intrinsics, look_at, orbit
from diffuphy.render.draw import rasterize, render_gaussians
from diffuphy.render.image import Image, Rasteriser
from diffuphy.render.raster import Warp

__all__ = ["Image", "Rasteriser", "Warp", "intrinsics", "look_at", "orbit", "rasterize", "render_gaussians"]
