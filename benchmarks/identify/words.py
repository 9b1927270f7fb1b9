"""What the page of the study says around its tables."""

INTRO = """# What a clip tells of its material

A ball of 0.3 m, 1500 particles, falls on the floor at 1.5 m/s: eight frames at 30 per second, 64 × 64 pixels, the
drop of the material stage. From the clip alone its material is to be found. A clip that the same discretisation
made would flatter (the inverse crime), so it is made by another one:

- **finer**: half the grid spacing, eight times the particles, half the Courant number, another draw of particles,
another place on the grid;
- **same** resolution, for comparison: another draw of particles and another place on the grid.

Two settings are not the same for all bodies: [sand](#what-discretisation-does) is seen at a wider angle, and both of
its simulations leave out what keeps elastic waves alive.

Rates carry Wilson's interval of 95 %. Errors of E are in decades (dex). Seconds are processor times of one thread
on a shared machine: {machine}. Every number here is written by `python -m benchmarks identify`.

## What was to be shown
"""

WHY = """
What is sought together is said in the rows; everything else is the truth's. The first row is the material stage
itself, the plastic laws are its scan; the others are least squares from the minima of a scan, which say what the clip
holds, apart from how it is found. Counts are those of the runs so far: the command goes on where it stopped, and
`--truths`, `--stages` and `--runs` ask for more.

Where it fails, and why:

- *The friction angle against a finer reference* is 3° to 6° too low, the more the smaller it is, where the same
  resolution finds it to 2°: within twice the tolerance, not always within it. A heap of grains is two or three cells
  deep, and what is left is the error of such a coarse flow; it [falls with the grid](#what-discretisation-does). With
  the scheme and the camera of the elastic bodies it was 7° to 9°.
- *ν beside E*: a drop shows ν five times less than E ([below](#what-can-be-told-at-all)), so that what the
  discretisation does to the clip goes into ν, and even what another draw of particles does; E stays right. State ν, or
  learn E alone.
- *E of what yields*: the clip shows the yield stress seven times as well as E, and the same errors go into E. State E.
- *A thin liquid*: the coarse grid has a viscosity of its own, and the fit finds 3 to 6 Pa s too little where the truth
  is below 100: of 12 Pa s that is a third.
- *Two halves, the softer one below*: the stiff half above hardly deforms, and what the clip shows best is the
  compliance of both together, 1/E + 1/E′; along it the error of the discretisation moves the fit to a smaller
  contrast, which [falls with the grid](#what-discretisation-does). The same body thrown on its other side is the row of
  the softer upper half. Side by side both meet the floor, both are seen [equally well](#what-can-be-told-at-all), the
  stiff one three times better than on top, and both are found: what is to be told apart has to be squeezed.
- *Two halves, the upper one softer, same resolution*: one truth narrowly misses the tolerance of the upper half. Seen
  as particles, a second minimum far away fits that truth as well as another draw of particles lets
  anything fit.
- *Training alone from too soft a start* went down to the softest material that is allowed while every step saw sharp
  pictures; it now sees [blurred ones first](../learning.md#a-start-that-is-too-soft), and comes up.
- *Training alone, the stiffest truths*: three of the five runs with a truth above 10^5.9 Pa end 0.20 to 0.25 dex too
  stiff. So stiff a ball hardly dents. After a scan no run is more than 0.12 dex off.
"""

STIFFNESS = """
## Stiffness, by the material stage

log₁₀ E of a truth between 3.9 and 5.9 (between 3.9 and 6.0 for training alone), ν and ρ known. *Whole stage*:
`FitMaterial` with 20 steps, scan and training, and a probe with elastic contact; *training alone*: 40 steps, the scan
left out, from a start that is too stiff or too soft by a given distance. The gradient is that of the product:
pixels → Gaussians → trajectory → adjoint of the simulation → network. *Steps to 0.1 dex*: after which the path
stays within it, median of the runs that end there.

"""

PARAMETERS = """
## Other parameters, by least squares

Levenberg–Marquardt with differences. It starts from the minima of a scan (eight values for one parameter, 6 × 6 for
two), of which the best three race for three steps and the winner goes on. *Particles*: the places of 500 points inside
the ball, at every frame; *1 camera* and *4 cameras* all round: pixels; *noise*: with a standard deviation of 0.05 of
the range of a pixel. *Two halves* lie on each other, *halves side by side* are left and right in the picture.

"""

LAWS = """
## Plastic law, by the scan

The scan of the material stage, forward only: four laws × five stiffnesses from 10⁴ to 10⁶ Pa. Truths have stiffness
off that grid, yield stress up to a factor of two and friction angle up to 10° from what the scan supposes. *Among
the best two*: what is refined before one is chosen (`material.refine`).

"""

RESOLUTION = """
## What discretisation does

Where least squares ends that starts at the truth, in the middle of the ranges, one camera: fits of several
resolutions against the same reference of 12 000 particles, whose grid is half as wide as that of 1500 and 0.7 times as
wide as that of 4000, so that the last step flatters. The scheme is that of both. On a *rigid* wall matter turns
back most of a cell above the floor; an *elastic* wall (`material.probe.scheme.contact=elastic`, the contact that films
are made with) lets it touch first.

For sand the scheme itself counts: its two additions have to go together, one alone brings little. Sharpening multiplies
what is rough in an acceleration, by a wall that separates the pressure too ([boundaries](../boundaries.md)): a coarse
heap flows more slowly. Retention keeps velocities that neighbours do not share: waves in an elastic body, noise in a
flow of grains. Both errors fall with the grid, and so does what is left without them.
Neither (`material.probe.scheme.sharpen=false material.probe.scheme.retain=0`) is how sand is dropped on this page, and
with an angle of view of 60° (`material.probe.view=60`): of 40° the heap runs out of the picture.

"""

SEEN = """
## What can be told at all

Least standard errors from the Fisher information (Cramér–Rao), at independent noise of 0.05 in every pixel, in dex,
or in shares of the range of the parameter for ν and the friction angle; `material.pixel_noise=0.05` puts them into
the report of a run. A hundred thousand pixels leave little to noise: what the tables above show is discretisation.
But the *condition* says along which combinations it is amplified, and some things no clip shows at any noise:

"""

SCALED = """
With density, E, yield stress and viscosity all eight times as large the largest difference of any pixel is
{differences}: a drop shows ratios to the density alone, and `material.learn` refuses `rho`.
"""

ELASTIC = """
Elastic laws, at the same E and ν, against neo-Hookean; root mean square difference of the pixels. Up to a flattening
by a seventh another draw of particles changes the clip more than another law does:

"""

PUBLISHED = """
## What others report

PAC-NeRF (Li et al., ICLR 2023, arXiv 2303.05512), LPO (Kaneko, arXiv 2406.04155) and GIC (Cai et al., NeurIPS 2024,
arXiv 2406.14927) measure the same kind of thing on clips that they simulate themselves, seen by many cameras, with
geometry to be found as well. Their tables are not repeated here: other bodies, other clips and other errors, and
what is theirs could not be read at its source when this page was written.
"""
