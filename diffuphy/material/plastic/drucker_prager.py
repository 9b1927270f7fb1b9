"""Drucker–Prager plasticity: sand, gravel, snow.

    volume  tr* = min(max(tr, χ min(t, 0)), 3c),  tr' = tr* − 3c           b = (tr* − tr)/3
    shape   δ = |ê| + (3κ/2μ) α tr'
            tr' = 0 (pulled apart): k = 0                                a = 1
            δ ≤ 0 (inside the cone): keep                                a = 0
            else: k = 1 − δ/|ê|                                          a = δ/|ê|

t = ln J is the total volume, of the grains and of the pores between them. Grains that were pulled apart bear nothing
until they are pressed back to the volume at which they touched, t = 0. A cone without this memory takes every volume at
which it is pressed for its own rest, and swells with every impact. With χ = 1 this is the volume correction of
Tampubolon et al., ACM TOG 36 (2017), §4.3.4, V_c = t − tr; such grains return all the work that pressed them and jump
from the floor. Pressed for the first time they are softer, p = −χ κ t, than when they are let go, dp = −κ dt: the
latching spring of Walton & Braun, J. Rheol. 30 (1986), whose restitution is √χ in a blow of any speed.

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

RESTITUTION = 0.4
"""Speed after over speed before a straight blow [-]: at 0.4 a dropped heap settles at once, at 1 it is flung up."""
LATCH = RESTITUTION**2
"""χ, stiffness of the first loading over that of unloading [-]."""

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
    real, theta_t, memory_t = layout.real, layout.theta_t, layout.memory_t
    at, at_c, at_nu = layout.at("friction_angle"), layout.at("cohesion"), layout.at("nu")
    at_t = layout.remembers("log_J")
    m = moduli.build(layout)
    degree = real(math.pi / 180.0)
    root = real(2.0 * math.sqrt(2.0 / 3.0))
    root2 = real(math.sqrt(2.0))
    plane = cone == "plane_strain"
    chi = real(LATCH)

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
    def flow(n: real, tr: real, theta: theta_t, dt: real, h: memory_t):
        t = h[at_t]
        pressed = wp.max(tr, chi * wp.min(t, real(0.0)))
        x = pressed - real(3.0) * theta[at_c]  # tr'
        a = real(0.0)
        b = (pressed - tr) / real(3.0)
        if x >= real(0.0):
            a = real(1.0)
            b = theta[at_c] - tr / real(3.0)
        else:
            al, _dal = alpha(theta)
            d = n + m.ratio(theta) * al * x
            if d > real(0.0):
                a = d / n
        return a, b

    @wp.func(module="unique")
    def flow_adjoint(n: real, tr: real, theta: theta_t, dt: real, a_bar: real, b_bar: real, h: memory_t):
        t = h[at_t]
        pressed = wp.max(tr, chi * wp.min(t, real(0.0)))
        x = pressed - real(3.0) * theta[at_c]
        n_bar = real(0.0)
        tr_bar = -b_bar / real(3.0)
        h_bar = memory_t()
        theta_bar = theta_t()
        if x >= real(0.0):
            theta_bar[at_c] = b_bar
        else:
            x_bar = real(0.0)
            al, dal = alpha(theta)
            q = m.ratio(theta)
            if n + q * al * x > real(0.0):  # a = 1 + q α tr'/n
                g = a_bar / n
                n_bar = -g * q * al * x / n
                x_bar = g * q * al
                theta_bar[at] = g * q * x * dal
                u = real(1.0) - real(2.0) * theta[at_nu]
                theta_bar[at_nu] = g * al * x * real(3.0) / (u * u)  # dq/dν = 3/(1 − 2ν)²
            theta_bar[at_c] = real(-3.0) * x_bar
            x_bar += b_bar / real(3.0)
            if pressed == tr:
                tr_bar += x_bar
            elif t < real(0.0):
                h_bar[at_t] = chi * x_bar
        return n_bar, tr_bar, theta_bar, h_bar

    return PlasticFunctions(flow, flow_adjoint)


def flow_cone(n: Tensor, tr: Tensor, params: dict[str, Tensor], t: Tensor, cone: Cone) -> tuple[Tensor, Tensor]:
    """(a, b) of the trial state with |ê| = n, tr e = tr and total volume e^t."""
    after = torch.minimum(torch.maximum(tr, LATCH * t.clamp_max(0)), 3 * params["cohesion"])
    x = after - 3 * params["cohesion"]
    ratio = (1 + params["nu"]) / (1 - 2 * params["nu"])
    d = n + ratio * slope(params["friction_angle"], cone) * x
    cone_flow = torch.where(d > 0, d / torch.where(n > 0, n, torch.ones_like(n)), torch.zeros_like(n))
    return torch.where(x >= 0, torch.ones_like(n), cone_flow), (after - tr) / 3


def drucker_prager(name: str, cone: Cone) -> Plastic:
    """The law with one of the two cones."""
    return Plastic(
        name=name,
        params=(moduli.E, moduli.NU, FRICTION_ANGLE, COHESION),
        build=lambda layout: build_cone(layout, cone),
        flow=lambda n, tr, params, dt, h: flow_cone(n, tr, params, h["log_J"], cone),
        memory=("log_J",),
    )


LAW = drucker_prager("drucker_prager", "compression")
PLANE_STRAIN = drucker_prager("drucker_prager_plane_strain", "plane_strain")
