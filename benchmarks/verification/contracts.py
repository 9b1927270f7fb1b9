"""D6, D8–D12, D14, D16, D17: input that makes no sense is refused by name; what is only odd gives a finite answer."""

import dataclasses
import math

import torch

from benchmarks.verification.bodies import Body, at_rest
from benchmarks.verification.case import Check, Setting, at_least, at_most, case, near
from benchmarks.verification.extremes import DX, PRECISIONS, cube, det, film
from benchmarks.verification.points import EYE, refused, yes
from diffuphy.material import kirchhoff
from diffuphy.material.decoder import gate
from diffuphy.mpm import HalfSpace, simulate


@case("D6", "Deformations that do not exist", schemes=("default",))
def inverted(s: Setting) -> list[Check]:
    """F = diag(1, 1, −½), 0 and NaN are no states of matter: refused, with particle and det F, under every law."""
    checks = []
    for law in ("neo_hookean", "fixed_corotated", "hencky"):
        body = cube(elastic=law)
        for what, value in {"diag(1, 1, −½)": (0.0, 0.0, -1.5), "0": (-1.0,) * 3, "NaN": (math.nan,) * 3}.items():
            start = at_rest(s, body)
            He = start.He.clone()
            He[5] = torch.diag(He.new_tensor(value))
            bad = dataclasses.replace(start, He=He)
            found = refused(lambda b=bad, y=body: film(s, y, 400.0, 1, state=b), words=("particle 5",))  # fmt: skip
            checks.append(yes(f"{law}: F = {what} refused", found))
    return checks


@case("D6b", "Ill-conditioned deformations", schemes=("default",))
def conditioned(s: Setting) -> list[Check]:
    """τ = 2μ ln S of F = diag(1e3, 1, 1e-3) (ν = 0): ln S to 1e-9 in float64, turned or not, and to 1e-4 in float32.

    Turned, F rounds at 1e3 ε beside a stretch of 1e-3: 1e-10 in float64.
    """
    exact = torch.diag(torch.tensor([1e3, 1.0, 1e-3], dtype=torch.float64))
    R = torch.linalg.matrix_exp(torch.tensor([[0, -0.3, 0.2], [0.3, 0, -0.5], [-0.2, 0.5, 0]], dtype=torch.float64))
    strain = torch.diag(exact.diagonal().log())
    params = {"E": 1.0, "nu": 0.0}  # 2μ = 1
    checks = []
    for name, dtype in PRECISIONS.items():
        error = float((kirchhoff(exact.to(dtype), "hencky", params).double() - strain).abs().max() / strain.abs().max())
        checks.append(at_most(f"error of ln S, {name}", error, 1e-9 if dtype == torch.float64 else 1e-4))
    turned = kirchhoff(R @ exact @ R, "hencky", params) - R @ strain @ R.T
    return [*checks, at_most("error of ln S, turned, float64", float(turned.abs().max() / strain.abs().max()), 1e-9)]


@case("D6c", "Equal stretches", schemes=("default",))
def repeated(s: Setting) -> list[Check]:
    """F = I, R, 0.9 R, diag(1.1, 1.1, 0.9): τ is that of the principal stretches, and its derivative along random
    directions that of central differences.

    Step h = 1e-5: h² of the third derivative and ε/h of rounding, 1e-10 of E.
    """
    g = torch.Generator().manual_seed(1)
    R = torch.linalg.matrix_exp(torch.tensor([[0, -0.7, 0.2], [0.7, 0, -0.4], [-0.2, 0.4, 0]], dtype=torch.float64))
    Fs = {"I": EYE, "R": R, "0.9 R": 0.9 * R, "diag(1.1, 1.1, 0.9)": torch.diag(EYE.new_tensor([1.1, 1.1, 0.9]))}
    params = {"E": 1.0, "nu": 0.3}
    mu, lam = 1 / 2.6, 0.3 / (1.3 * 0.4)
    A, D = (torch.randn(3, 3, dtype=torch.float64, generator=g) for _ in range(2))
    checks = []
    for what, F in Fs.items():
        worst_value = worst_slope = 0.0
        for law in ("neo_hookean", "fixed_corotated", "hencky"):
            stretch = torch.linalg.svdvals(F)  # F = S R or diagonal: τ is diagonal in the axes of F Fᵀ
            J = stretch.prod()
            e = stretch.log()
            T = {
                "neo_hookean": mu * (stretch**2 - 1) + lam * J.log(),
                "fixed_corotated": 2 * mu * stretch * (stretch - 1) + lam * J * (J - 1),
                "hencky": 2 * mu * e + lam * J.log(),
            }[law]
            leaf = F.clone().requires_grad_()
            tau = kirchhoff(leaf, law, params)
            worst_value = max(worst_value, float((tau.detach() - torch.diag(T)).abs().max()))
            (bar_,) = torch.autograd.grad((tau * A).sum(), [leaf])
            h = 1e-5
            up, down = (float((kirchhoff(F + k * h * D, law, params) * A).sum()) for k in (1, -1))
            worst_slope = max(worst_slope, abs(float((bar_ * D).sum()) - (up - down) / (2 * h)))
        checks.append(at_most(f"F = {what}: |τ − exact|/E", worst_value, 1e-14))
        checks.append(at_most(f"F = {what}: |dτ − differences|/E", worst_slope, 1e-8))
    return checks


@case("D8", "Particles that leave", schemes=("default",))
def leaving(s: Setting) -> list[Check]:
    """Out of the bounds: an exception that names the particle; or frozen, the mass unchanged; or removed, the mass
    announced. Places below 0 are places like others: ⌊x⌋, not the part before the point."""
    body = cube(cells=1)
    bounds = ((-1.0, -1.0, -1.0), (1.0, 1.0, 0.4))
    flight = {"velocity": (0.0, 0.0, 1.0), "bounds": bounds}
    named = refused(lambda: film(s, body, 50.0, 8, **flight), words=("particle",))
    checks = [yes("an exception names the particle", named)]
    for policy in ("freeze", "remove"):
        _, reports = film(s, body, 50.0, 8, leaving=policy, **flight)
        last = reports[-1]
        checks.append(near(f"{policy}: particles gone", last.gone, len(body.x), 0.0))
        exact = float(body.m.sum()) if policy == "remove" else 0.0
        checks.append(near(f"{policy}: mass announced", last.removed, exact, 1e-12 * float(body.m.sum()), "kg"))
    kick = 0.3 * torch.sin(9.0 * body.x)
    ends = []
    for place in (0.0, -8.0):
        there = dataclasses.replace(body, x=body.x + place * DX)
        ends.append(film(s, there, 50.0, 2, velocity=kick)[0][-1].v)
    return [*checks, at_most("|change of v| 8 Δx below 0", float((ends[1] - ends[0]).abs().max()), 2000 * 2.0**-52)]


@case("D9", "One particle, two in one place, none", schemes=("default",))
def few(s: Setting) -> list[Check]:
    """x = x0 + v0 t + g t²/2 of one particle, and of two in one place, which move as one; none is refused.

    Thirty substeps of sums of 27 weights: 200 ε.
    """
    g, v0, checks = (0.0, 0.0, -9.81), (0.3, -0.2, 0.5), []
    for copies in (1, 2):
        x = torch.tensor([[0.113, -0.021, 0.337]], dtype=torch.float64).repeat(copies, 1)
        body = Body(x, torch.full((copies,), 1e-5, dtype=torch.float64))
        end = film(s, body, 50.0, 2, gravity=g, velocity=v0)[0][-1]
        exact = x[0] + 0.04 * x.new_tensor(v0) + 0.5 * 0.04**2 * x.new_tensor(g)
        checks.append(at_most(f"|x − exact|, {copies}", float((end.x - exact).abs().max()), 200 * 2.0**-52, "m"))
        checks.append(yes(f"all at one place, {copies}", torch.equal(end.x[0], end.x[-1])))
    none = Body(torch.zeros(0, 3, dtype=torch.float64), torch.zeros(0, dtype=torch.float64))
    return [*checks, yes("none refused", refused(lambda: film(s, none, 50.0, 1), words=("N > 0",)))]


@case("D10", "Nodes with next to no mass", schemes=("default",))
def featherweight(s: Setting) -> list[Check]:
    """A particle at the edge of a cell gives a node ε²/8 of its mass, and masses are near the smallest number: v = p/m
    without an ε, so that velocities stay those of the particles, to rounding."""
    checks = []
    for name, dtype in PRECISIONS.items():
        eps, tiny = torch.finfo(dtype).eps, torch.finfo(dtype).tiny * 1e6
        edge = (0.5 - eps) * DX
        x = torch.tensor([[edge, edge, edge], [edge + DX, edge, edge]], dtype=dtype)
        body = Body(x, torch.full((2,), 1e-3, dtype=dtype), E=tiny * 1e5, rho=tiny * 1e3)
        states, _ = film(s, body, 50.0, 2, velocity=(1.0, 0.5, -0.3))
        checks.append(at_most(f"|v − v0|, {name}", float((states[-1].v - states[0].v).abs().max()), 3000 * eps, "m/s"))
    return checks


@case("D11", "Impossible numbers", schemes=("default",))
def impossible(s: Setting) -> list[Check]:
    """NaN, ∞ and values out of range in row 37 of an input are refused, with its name and the row; a wall of negative
    friction is refused."""
    spoiled = {"x": math.nan, "vol": 0.0, "rho": -1.0, "E": -1e5, "nu": math.nan, "w_e": math.inf,
               "yield_stress": -1.0, "velocity": math.nan}  # fmt: skip
    body, checks = cube(elastic="hencky", plastic="von_mises"), []
    scene = dataclasses.replace(s.scene(dx=DX), fps=50.0)
    for what, value in spoiled.items():
        x, vol, field, v = body.x.clone(), body.vol.clone(), body.field, torch.zeros_like(body.x)
        known = {"x": x, "vol": vol, "rho": field.rho, "w_e": field.w_e, "velocity": v}
        known.get(what, field.theta.get(what, v))[37] = value
        found = refused(lambda a=(x, vol, field), b=v: list(simulate(scene, *a, frames=1, velocity=b)),
                        words=(what, "particle 37"))  # fmt: skip
        checks.append(yes(f"{what} = {value} refused", found))
    return [*checks, yes("friction −0.1 refused", refused(lambda: HalfSpace(friction=-0.1), words=("friction",)))]


@case("D12", "Rest", schemes=("default",))
def rest(s: Setting) -> list[Check]:
    """g = 0, v = 0, F = I: after 1000 substeps every bit of x, v, C, F is as before."""
    checks = []
    for name, dtype in PRECISIONS.items():
        body = cube(dtype, cells=1)
        states, reports = film(s, body, 2.0, 2, dt=9e-4)
        end = states[-1]
        same = torch.equal(end.x, body.x) and not any(bool(t.any()) for t in (end.v, end.C, end.He))
        checks.append(yes(f"the same bits after {sum(r.n_sub for r in reports)} substeps, {name}", same))
    return checks


@case("D14", "Gates of huge logits", schemes=("default",))
def huge(s: Setting) -> list[Check]:
    """Logits of ±1e4: weights are exactly one-hot, gradients finite; those of softmax in half precision too."""
    checks = []
    for dtype in (torch.float16, torch.bfloat16, torch.float32, torch.float64):
        for kind in ("softmax",) if dtype.itemsize < 4 else ("softmax", "sparsemax"):
            logits = torch.tensor([[1e4, -1e4, 0.0]], dtype=dtype, requires_grad=True)
            w = gate(logits, kind)
            (bar_,) = torch.autograd.grad((w * w.new_tensor([1.0, 2.0, 3.0])).sum(), [logits])
            same = w.tolist() == [[1.0, 0.0, 0.0]] and bool(torch.isfinite(bar_).all())
            checks.append(yes(f"{kind}, {str(dtype)[6:]}: one-hot, gradient finite", same))
    return checks


@case("D16", "More nodes than indices", schemes=("default",))
def numberless(s: Setting) -> list[Check]:
    """Two particles a kilometre apart on a grid of 1 cm, 1e15 nodes: refused, with what to change."""
    x = torch.tensor([[0.0, 0.0, 0.0], [1e3, 1e3, 1e3]], dtype=torch.float64)
    body = Body(x, torch.full((2,), 1e-6, dtype=torch.float64))
    return [yes("refused", refused(lambda: film(s, body, 50.0, 1, dx=0.01), words=("cells", "enlarge dx")))]


@case("D17", "Thin and broken bodies", schemes=("default",))
def thin(s: Setting) -> list[Check]:
    """A sheet one particle thick, a line, a cloud with holes, shaken at 0.3 m/s: finite, upright, no faster than twice
    what they were given."""
    whole, checks = cube(cells=3), []
    x = whole.x
    flat = x[:, 2] == x[0, 2]
    shapes = {"sheet": flat, "line": flat & (x[:, 1] == x[0, 1]), "holes": torch.arange(len(x)) % 3 == 0}
    for name, keep in shapes.items():
        body = Body(x[keep], whole.vol[keep])
        end = film(s, body, 50.0, 2, velocity=0.3 * torch.sin(9.0 * body.x))[0][-1]
        checks.append(at_least(f"{name}: smallest J", float(det(end.F).min()), 1e-6))
        fast = float(end.v.norm(dim=1).max())
        checks.append(at_most(f"{name}: largest speed", fast, 2 * 0.3 * math.sqrt(3.0), "m/s"))
    return checks
