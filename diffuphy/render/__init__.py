"""Rendering of Gaussians: rasterisers, colours, cameras, the skin that ties them to particles, and the film."""

from diffuphy.render.cameras import intrinsics, look_at, orbit
from diffuphy.render.draw import rasterize, render_gaussians
from diffuphy.render.film.clip import Film
from diffuphy.render.film.video import contact_sheet, write_mp4, write_png
from diffuphy.render.gsplat import Gsplat
from diffuphy.render.image import Image, Rasteriser
from diffuphy.render.project import Dense
from diffuphy.render.raster import Warp
from diffuphy.render.skin import Skin

__all__ = [
    "Dense",
    "Film",
    "Gsplat",
    "Image",
    "Rasteriser",
    "Skin",
    "Warp",
    "contact_sheet",
    "intrinsics",
    "look_at",
    "orbit",
    "rasterize",
    "render_gaussians",
    "write_mp4",
    "write_png",
]
