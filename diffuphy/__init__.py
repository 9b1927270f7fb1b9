"""From a sentence to a physically true 3D film.

    prompt → Gaussians → particles → material field → trajectory → film

Start reading at :mod:`diffuphy.types`, then :mod:`diffuphy.pipeline`. Importing the package loads nothing heavy.
"""

__version__ = "0.1.0"
