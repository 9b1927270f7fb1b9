"""The rasteriser in Warp: autograd bridge between torch tensors and the kernels of ``diffuphy.render.kernels``."""

from dataclasses import dataclass
from functools import cache
from types import SimpleNamespace
from typing import Any, Literal

import torch
import warp as wp
from torch import Tensor
from torch.autograd.function import once_differentiable

from diffuphy.compiling import load
from diffuphy.render.image import Image
from diffuphy.render.kernels import array, real_of, spread
from diffuphy.render.kernels.binning import bin_by_counting, bin_by_sorting, tiling
from diffuphy.render.kernels.compositing import compositing_kernels
from diffuphy.render.kernels.projection import projection_kernels
from diffuphy.types import Camera


@dataclass(frozen=True)
class Warp:
    """Tile rasteriser of this package; runs on CPU and CUDA, in float32 and float64, differentiable in every operand.

    Zwicker et al., EWA splatting (2002); Kerbl et al., 3D Gaussian splatting (2023). On one device the result is
    bit-identical from run to run, except for the gradients of the ``pixel`` driver on CUDA, which are summed by
    atomics.
    """

    dilation: float = 0.3
    """ε added to the diagonal of the 2D covariance [px²]: no Gaussian is thinner than a pixel can show (Kerbl et al.
    2023)."""
    near: float = 0.01
    """Centres nearer to the camera plane are not drawn [unit of the means], as in gsplat."""
    alpha_min: float = 1 / 255
    """Contributions below this opacity are left out [-]: one step of an 8-bit image."""
    alpha_max: float = 0.99
    """Largest opacity of one Gaussian at a pixel [-]; bounds 1 / (1 - α) in the adjoint (Kerbl et al. 2023)."""
    T_min: float = 1e-4
    """A pixel is finished when it transmits less than this [-]: what lies behind changes it by at most as much."""
    driver: Literal["auto", "tile", "pixel"] = "auto"
    """Thread layout: one thread a tile, one a pixel, or what suits the device ("tile" on CPU, "pixel" on CUDA)."""
    tile: int = 0
    """Side of a tile [px]; 0 chooses 32 for the tile driver (the pixels fit the first-level cache) and 8 for the
    pixel driver."""
    threads: int = 2
    """CPU threads; never changes a result."""

    def __post_init__(self) -> None:
        if self.driver not in ("auto", "tile", "pixel"):
            raise ValueError(f'driver must be "auto", "tile" or "pixel", got "{self.driver}"')
        if not (self.dilation > 0 and self.near > 0 and self.tile >= 0 and self.threads >= 1):
            raise ValueError(f"dilation, near and threads must be positive and tile not negative, got {self}")
        if not (0 < self.alpha_min < self.alpha_max < 1 and 0 <= self.T_min < 1):
            raise ValueError(f"0 < alpha_min < alpha_max < 1 and 0 <= T_min < 1 must hold, got {self}")

    def __call__(
        self,
        means: Tensor,
        quats: Tensor,
        scales: Tensor,
        opacities: Tensor,
        colors: Tensor,
        camera: Camera,
        F: Tensor | None = None,
    ) -> Image:
        """See :func:`diffuphy.render.rasterize`."""
        viewmats, Ks = (x.to(means).contiguous() for x in (camera.viewmats, camera.Ks))
        size = (camera.width, camera.height)
        means2d, conics, depths, sigmas = _Project.apply(means, quats, scales, F, viewmats, Ks, size, self)
        if means2d.requires_grad:
            means2d.retain_grad()
        colors = colors if colors.dim() == 3 else colors[None]
        rgb, alpha, depth = _Composite.apply(means2d, conics, depths, colors, opacities, sigmas, size, self)
        return Image(rgb, alpha, depth, means2d)

    def layout(self, device: torch.device) -> tuple[str, int]:
        """Driver and tile side used on ``device``."""
        driver = self.driver if self.driver != "auto" else ("tile" if device.type == "cpu" else "pixel")
        return driver, self.tile or (32 if driver == "tile" else 8)

    def threads_for(self, items: int) -> int:
        """Threads for so many Gaussians times views, outside the compositing."""
        return max(1, min(self.threads, items // THREAD_SHARE))


THREAD_SHARE = 8192
"""Fewest Gaussians times views that are worth a thread of their own; starting one costs as much as projecting them."""


@cache
def _vectors(real: type) -> SimpleNamespace:
    """Warp types of the tensors that cross the bridge."""
    vec2, vec3, vec4 = (wp.types.vector(n, real) for n in (2, 3, 4))
    mat33, mat44 = wp.types.matrix((3, 3), real), wp.types.matrix((4, 4), real)
    return SimpleNamespace(
        real=real,
        vec2=vec2,
        vec3=vec3,
        vec4=vec4,
        operands=(vec3, vec4, vec3, mat33, mat44, mat33),
        projected=(vec2, vec3, real, vec2),
    )


def _spread_launch(
    kernel: wp.Kernel, dim: tuple[int, ...], axis: int, inputs: list, device: torch.device, threads: int
) -> None:
    """Launch ``kernel`` over ``dim``, on the CPU cut along ``axis`` into one launch a thread; the first argument is
    the start."""
    wp_device = wp.device_from_torch(device)
    load(kernel, wp_device)  # before the threads, which must not compile it twice

    def launch(start: int, length: int) -> None:
        part = (*dim[:axis], length, *dim[axis + 1 :])
        wp.launch(kernel, dim=part, inputs=[start, *inputs], device=wp_device)

    spread(launch, dim[axis], threads if device.type == "cpu" else 1)


class _Project(torch.autograd.Function):
    """(means, quats, scales, F) → (means2d, conics, depths; sigmas without gradient), all views at once."""

    @staticmethod
    def forward(ctx: Any, means, quats, scales, F, viewmats, Ks, size, settings):
        real = real_of(means.dtype)
        kernels = projection_kernels(real, F is not None)
        views, count = len(viewmats), len(means)
        operands = [x.contiguous() for x in (means, quats, scales, means.new_empty(0, 3, 3) if F is None else F)]
        outputs = [means.new_empty(views, count, n) for n in (2, 3, 1, 2)]
        outputs[2] = outputs[2][..., 0]
        vectors = _vectors(real)
        inputs = [array(x, t) for x, t in zip([*operands, viewmats, Ks], vectors.operands, strict=True)]
        inputs += [float(size[0]), float(size[1]), settings.dilation, settings.near]
        inputs += [array(x, t) for x, t in zip(outputs, vectors.projected, strict=True)]
        _spread_launch(kernels.project, (count,), 0, inputs, means.device, settings.threads_for(views * count))
        ctx.save_for_backward(*operands, viewmats, Ks, outputs[1])
        ctx.deformed, ctx.size, ctx.settings = F is not None, size, settings
        ctx.mark_non_differentiable(outputs[3])
        return tuple(outputs)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, g_means2d, g_conics, g_depths, _):
        *operands, viewmats, Ks, conics = ctx.saved_tensors
        real = real_of(conics.dtype)
        vectors = _vectors(real)
        grads = [torch.empty_like(x) for x in operands]
        inputs = [array(x, t) for x, t in zip([*operands, viewmats, Ks], vectors.operands, strict=True)]
        inputs += [float(ctx.size[0]), float(ctx.size[1]), ctx.settings.near]
        incoming = [conics, g_means2d.contiguous(), g_conics.contiguous(), g_depths.contiguous()]
        types = [vectors.projected[1], *vectors.projected[:3]]
        inputs += [array(x, t) for x, t in zip(incoming, types, strict=True)]
        inputs += [array(x, t) for x, t in zip(grads, vectors.operands, strict=False)]
        kernel = projection_kernels(real, ctx.deformed).project_adjoint
        _spread_launch(
            kernel, (len(operands[0]),), 0, inputs, conics.device, ctx.settings.threads_for(g_depths.numel())
        )
        return (*grads[:3], grads[3] if ctx.deformed else None, None, None, None, None)


class _Composite(torch.autograd.Function):
    """(means2d, conics, depths, colors, opacities) → (rgb, alpha, depth)."""

    @staticmethod
    def forward(ctx: Any, means2d, conics, depths, colors, opacities, sigmas, size, settings):
        operands = [x.contiguous() for x in (means2d, conics, depths, colors, opacities, sigmas)]
        boxes = _boxes(operands[0], operands[5], operands[4], size, settings)
        driver, tile = settings.layout(means2d.device)
        columns, rows = tiling(*size, tile)
        if means2d.device.type == "cpu":
            offsets, ids = bin_by_counting(boxes, depths, tile, columns, rows, settings.threads_for(depths.numel()))
        else:
            offsets, ids = bin_by_sorting(boxes, depths, tile, columns, rows)
        splats, kernels, types = _splats(operands, (boxes, offsets, ids), size, settings)
        ctx.splats, ctx.size, ctx.settings = (splats, kernels, types), size, settings
        views = len(means2d)
        pixels = means2d.new_empty(views, size[1], size[0], 4)
        T = means2d.new_empty(views, size[1], size[0])
        inputs = [splats, array(pixels.view(-1, 4), types.vec4), array(T.view(-1), types.real)]
        if driver == "tile":
            dim, axis, kernel = (columns * rows, views), 0, kernels.tile
        else:
            dim, axis, kernel = (views, size[1], size[0]), 1, kernels.pixel
        _spread_launch(kernel, dim, axis, inputs, means2d.device, settings.threads)
        # the operands only so that autograd notices if one is changed in place: the kernels read them through
        # ``splats``
        ctx.save_for_backward(*operands, pixels, T)
        ctx.set_materialize_grads(False)
        return pixels[..., :3], 1 - T, pixels[..., 3]

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, g_rgb, g_alpha, g_depth):
        *operands, pixels, T = ctx.saved_tensors
        splats, kernels, types = ctx.splats
        g_pixels = torch.empty_like(pixels)
        g_pixels[..., :3] = 0 if g_rgb is None else g_rgb
        g_pixels[..., 3] = 0 if g_depth is None else g_depth
        g_alpha = torch.zeros_like(T) if g_alpha is None else g_alpha.contiguous()
        g_means2d, g_conics = (torch.zeros_like(x) for x in operands[:2])
        views, count = g_means2d.shape[:2]
        g_features = pixels.new_zeros(views, count, 4)
        g_opacities = pixels.new_zeros(views, count)
        inputs = [
            splats,
            array(pixels.view(-1, 4), types.vec4),
            array(T.view(-1), types.real),
            array(g_pixels.view(-1, 4), types.vec4),
            array(g_alpha.view(-1), types.real),
        ]
        outputs = [
            array(x, t)
            for x, t in (
                (g_means2d, types.vec2),
                (g_conics, types.vec3),
                (g_features, types.vec4),
                (g_opacities, types.real),
            )
        ]
        driver, tile = ctx.settings.layout(T.device)
        if driver == "tile":
            columns, rows = tiling(*ctx.size, tile)
            scratch = torch.empty(2, *T.shape, dtype=T.dtype, device=T.device)
            inputs += [array(scratch[0].view(-1), types.real), array(scratch[1].view(-1), types.real)]
            dim, kernel = (views, columns * rows), kernels.tile_adjoint
        else:
            dim, kernel = (views, ctx.size[1], ctx.size[0]), kernels.pixel_adjoint
        # cut by views: on the CPU two threads must not add to one row
        _spread_launch(kernel, dim, 0, inputs + outputs, T.device, ctx.settings.threads)
        g_colors = g_features[..., :3]
        if len(operands[3]) == 1:
            g_colors = g_colors.sum(0, keepdim=True)
        return g_means2d, g_conics, g_features[..., 3], g_colors, g_opacities.sum(0), None, None, None


def _boxes(means2d: Tensor, sigmas: Tensor, opacities: Tensor, size: tuple[int, int], settings: Warp) -> Tensor:
    """Boxes of pixels that the Gaussians reach, shape (C, G, 4), int32."""
    real = real_of(means2d.dtype)
    types = _vectors(real)
    boxes = torch.empty(*means2d.shape[:2], 4, dtype=torch.int32, device=means2d.device)
    inputs = [array(means2d, types.vec2), array(sigmas, types.vec2), array(opacities, real), *size, settings.alpha_min]
    inputs += [array(boxes, wp.vec4i)]
    kernel = projection_kernels(real, False).bound
    _spread_launch(kernel, (means2d.shape[1],), 0, inputs, means2d.device, settings.threads_for(sigmas.numel() // 2))
    return boxes


def _splats(
    operands: list[Tensor], lists: tuple[Tensor, ...], size: tuple[int, int], settings: Warp
) -> tuple[Any, Any, Any]:
    """The kernels' view of the operands, the kernels, and the Warp types of the pixels."""
    means2d, conics, depths, colors, opacities, sigmas = operands
    boxes, offsets, ids = lists
    types = _vectors(real_of(means2d.dtype))
    kernels = compositing_kernels(types.real)
    splats = kernels.Splats()
    for name, tensor, dtype in (
        ("means2d", means2d, types.vec2),
        ("conics", conics, types.vec3),
        ("sigmas", sigmas, types.vec2),
        ("depths", depths, types.real),
        ("colors", colors, types.vec3),
        ("opacities", opacities, types.real),
        ("boxes", boxes, wp.vec4i),
        ("offsets", offsets, wp.int32),
        ("ids", ids, wp.int32),
    ):
        setattr(splats, name, wp.from_torch(tensor.detach(), dtype=dtype, requires_grad=False))
    _, splats.tile = settings.layout(means2d.device)
    splats.width, splats.height = size
    splats.columns = tiling(*size, splats.tile)[0]
    splats.alpha_min, splats.alpha_max, splats.T_min = settings.alpha_min, settings.alpha_max, settings.T_min
    return splats, kernels, types
