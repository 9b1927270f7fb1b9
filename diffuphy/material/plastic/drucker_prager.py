"""Drucker–Prager plasticity: sand, gravel, snow.

    tr' = tr − 3c,  δ = |ê| + (3κ/2μ) α tr'
    tr' ≥ 0 (pulled apart): k = 0, m = c          (a = 1, b = −tr'/3)
    δ ≤ 0 (inside the cone): keep                 (a = b = 0)
    else: k = 1 − δ/|ê|, m = tr/3                 (a = δ/|ê|, b = 0)

On the cone |dev τ| = 3α p with p = −κ tr'. The slope α comes from the friction angle φ by fitting Mohr–Coulomb in

    "compression":  α = √(2/3) 2 sin φ / (3 − sin φ)      the formula of graphics; matches triaxial compression
    "plane_strain": α = √2 tan φ / √(9 + 12 tan² φ)       matches slopes and walls, which are in plane strain

(at φ = 30° the first acts like 49° in plane strain). Cohesion c is a volumetric Hencky strain per axis.
Klár et al., ACM TOG 35 (2016), §6; Drucker & Prager, Quart. Appl. Math. 10 (1952).
"""

import math
from typing import Literal

import torch
import warp as wp
from torch import Tensor

from .. import moduli
from ..expert import Layout, Param, Plastic, PlasticFunctions

FRICTION_ANGLE = Param("friction_angle", "deg", 5.0, 60.0, log=False, default=30.0)
COHESION = Param("cohesion", "-", 0.0, 0.1, log=False, default=0.0)

Cone = Literal["compression", "plane_strain"]


def slope(friction_angle: Tensor, cone: Cone) -> Tensor:
    """Slope α of the cone [-] from the friction angle [deg]."""
    phi = torch.deg2rad(friction_angle)
    if cone == "plane_strain":
        t = torch.tan(phi)
        return math.sqrt(2.0) * t / torch.sqrt(9 + 12 * t * t)
    return math.sqrt(2 / 3) * 2 * torch.sin(phi) / (3 - torch.sin(phi))


def build_cone(layout: Layout, cone: Cone) -> PlasticFunctions:
    """Warp functions for one layout and one cone."""
    real, theta_t = layout.real, layout.theta_t
    at, at_c, at_nu = layout.at("friction_angle"), layout.at("cohesion"), layout.at("nu")
    m = moduli.build(layout)
    degree = real(math.pi / 180.0)
    root = real(2.0 * math.sqrt(2.0 / 3.0))
    root2 = real(math.sqrt(2.0))
    plane = cone == "plane_strain"

    @wp.func(module="unique")
    def alpha(theta: theta_t):
        """α and dα/dφ [1/deg]."""
        s = wp.sin(degree * theta[at])
        if wp.static(plane):  # √2 sin φ / √(9 cos² φ + 12 sin² φ)
            r = real(1.0) / wp.sqrt(real(9.0) + real(3.0) * s * s)
            return root2 * s * r, degree * wp.cos(degree * theta[at]) * root2 * real(9.0) * r * r * r
        else:
            r = real(1.0) / (real(3.0) - s)
            return root * s * r, degree * wp.cos(degree * theta[at]) * root * real(3.0) * r * r

    @wp.func(module="unique")
    def flow(n: real, tr: real, theta: theta_t, dt: real):
        t = tr - real(3.0) * theta[at_c]
        a = real(0.0)
        b = real(0.0)
        if t >= real(0.0):
            a = real(1.0)
            b = -t / real(3.0)
        else:
            al, _dal = alpha(theta)
            d = n + m.ratio(theta) * al * t
            if d > real(0.0):
                a = d / n
        return a, b

    @wp.func(module="unique")
    def flow_adjoint(n: real, tr: real, theta: theta_t, dt: real, a_bar: real, b_bar: real):
        t = tr - real(3.0) * theta[at_c]
        n_bar = real(0.0)
        t_bar = real(0.0)
        theta_bar = theta_t()
        if t >= real(0.0):
            t_bar = -b_bar / real(3.0)
        else:
            al, dal = alpha(theta)
            q = m.ratio(theta)
            if n + q * al * t > real(0.0):  # a = 1 + q α t'/n
                g = a_bar / n
                n_bar = -g * q * al * t / n
                t_bar = g * q * al
                theta_bar[at] = g * q * t * dal
                u = real(1.0) - real(2.0) * theta[at_nu]
                theta_bar[at_nu] = g * al * t * real(3.0) / (u * u)  # dq/dν = 3/(1 − 2ν)²
        theta_bar[at_c] = real(-3.0) * t_bar
        return n_bar, t_bar, theta_bar

    return PlasticFunctions(flow, flow_adjoint)


def flow_cone(n: Tensor, tr: Tensor, params: dict[str, Tensor], cone: Cone) -> tuple[Tensor, Tensor]:
    """(a, b) of the trial state with |ê| = n and tr e = tr."""
    t = tr - 3 * params["cohesion"]
    ratio = (1 + params["nu"]) / (1 - 2 * params["nu"])
    d = n + ratio * slope(params["friction_angle"], cone) * t
    cone_flow = torch.where((d > 0) & (t < 0), d / torch.where(n > 0, n, torch.ones_like(n)), torch.zeros_like(n))
    return torch.where(t >= 0, torch.ones_like(n), cone_flow), torch.where(t >= 0, -t / 3, torch.zeros_like(n))


def drucker_prager(name: str, cone: Cone) -> Plastic:
    """The law with one of the two cones."""
    return Plastic(
        name=name,
        params=(moduli.E, moduli.NU, FRICTION_ANGLE, COHESION),
        build=lambda layout: build_cone(layout, cone),
        flow=lambda n, tr, params, dt: flow_cone(n, tr, params, cone),
    )


LAW = drucker_prager("drucker_prager", "compression")
PLANE_STRAIN = drucker_prager("drucker_prager_plane_strain", "plane_strain")
