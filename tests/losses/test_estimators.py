"""What the estimators take from a prior's answers: exact laws, and the gradient of each backend written out by hand."""

import pytest
import torch

from diffuphy.losses import CSD, ISM, SDS, sds
from diffuphy.losses.guidance import TextGuidance
from diffuphy.losses.guidance.analytic import Analytic, Variants
from diffuphy.render import orbit
from diffuphy.text2gs.fit import FitGaussians
from diffuphy.types import Look

F64 = torch.float64


class Worded(Analytic):
    """A prior with exact answers to three texts; guidance 7.5."""

    def encode(self, sample):
        return sample

    def predict_parts(self, z_t, t, cond, parts):
        return tuple(Analytic.predict_noise(self, z_t, t, cond[part]) for part in parts)

    def predict_noise(self, z_t, t, cond):
        positive, negative = self.predict_parts(z_t, t, cond, ("positive", "negative"))
        return negative + 7.5 * (positive - negative)


def case(seed=0, batch=2, s=0.3):
    """A prior of one mode for each text, a latent, noise and times."""
    g = torch.Generator().manual_seed(seed)
    z, noise, *r = (torch.rand(batch, 3, 3, 3, generator=g, dtype=F64) for _ in range(5))
    cond = {part: Variants(x[:, None]) for part, x in zip(("positive", "negative", "empty"), r, strict=True)}
    return Worded(s=s, mode="independent"), z, noise, cond, torch.tensor([0.3005, 0.7005], dtype=F64)[:batch]


def answer(prior, z, t, cond, part):
    """ε̂ = σ (z − α m)/(α² s² + σ²), by hand."""
    a, s = (x.view(-1, 1, 1, 1) for x in prior.schedule(t))
    m = 2 * cond[part].images[:, 0] - 1
    return s * (z - a * m) / (a**2 * prior.s**2 + s**2)


def test_csd_is_the_difference_of_two_answers():
    """r = σ α (m⁻ − m)/(α² s² + σ²): for one mode a text, the noise and the sample cancel."""
    prior, z, noise, cond, t = case()
    a, s = (x.view(-1, 1, 1, 1) for x in prior.schedule(t))
    m, m_neg = (2 * cond[part].images[:, 0] - 1 for part in ("positive", "negative"))
    expected = s * a * (m_neg - m) / (a**2 * prior.s**2 + s**2)
    torch.testing.assert_close(CSD()(prior, z, cond, t=t, noise=noise), expected, rtol=1e-12, atol=1e-13)


def test_csd_is_what_sds_gains_for_each_unit_of_guidance():
    """r_SDS = ε̂_neg − ε + cfg · r_CSD."""
    prior, z, noise, cond, t = case()
    a, s = (x.view(-1, 1, 1, 1) for x in prior.schedule(t))
    rest = answer(prior, a * z + s * noise, t, cond, "negative") - noise
    left, right = (e(prior, z, cond, t=t, noise=noise) for e in (SDS(), CSD()))
    torch.testing.assert_close(left, rest + 7.5 * right, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("ism", [ISM(), ISM(delta=0.2, step=0.05), ISM(delta=0.9)])
def test_ism_is_the_answer_less_that_of_an_interval_before_on_the_inverted_path(ism):
    """z_{t'} = α'(z − σ ε̂)/α + σ' ε̂ step by step, sample by sample, written out."""
    prior, z, noise, cond, t = case()
    expected = []
    for b in range(2):
        one = {k: Variants(v.images[b : b + 1]) for k, v in cond.items()}
        t_b = t[b : b + 1]
        s_b = max(float(t_b) - ism.delta, ism.start)
        times = [ism.start]
        while times[-1] < s_b:
            times.append(min(times[-1] + ism.step, s_b))
        a, s = prior.schedule(torch.tensor(times[:1], dtype=F64))
        x = a * z[b : b + 1] + s * noise[b : b + 1]
        for k, now in enumerate(times):
            now_t, next_t = torch.tensor([now], dtype=F64), torch.tensor([*times, float(t_b)], dtype=F64)[k + 1 : k + 2]
            e = answer(prior, x, now_t, one, "empty")
            (a, s), (a1, s1) = prior.schedule(now_t), prior.schedule(next_t)
            x = a1 * (x - s * e) / a + s1 * e
        expected.append(prior.predict_noise(x, t_b, one) - e)
    found = ism(prior, z, cond, t=t, noise=noise)
    # float64; σ of the first step is 0.03, by which an answer's rounding is divided
    torch.testing.assert_close(found, torch.cat(expected), rtol=1e-10, atol=1e-10)


def test_ism_leaves_alone_what_the_prior_knows_by_heart():
    """With s = 0 and one reference for every text, z = r gives ε̂ = ε all along the path, and r = 0."""
    prior, z, noise, cond, t = case(s=0.0)
    cond = dict.fromkeys(cond, Variants((z[:, None] + 1) / 2))
    assert ISM()(prior, z, cond, t=t, noise=noise).abs().max() < 1e-10


def test_a_batch_of_times_is_each_time_alone():
    """A sample that has arrived waits without changing."""
    prior, z, noise, cond, t = case()
    both = ISM()(prior, z, cond, t=t, noise=noise)
    for b in range(2):
        one = {k: Variants(v.images[b : b + 1]) for k, v in cond.items()}
        alone = ISM()(prior, z[b : b + 1], one, t=t[b : b + 1], noise=noise[b : b + 1])
        torch.testing.assert_close(both[b : b + 1], alone, rtol=1e-13, atol=1e-13)


@pytest.mark.parametrize("estimator", [CSD(), ISM()])
def test_a_prior_without_words_is_refused_at_once(estimator):
    """And only such a one."""
    assert isinstance(Worded(), TextGuidance) and not isinstance(Analytic(), TextGuidance)
    estimator.check(Worded())
    with pytest.raises(ValueError, match="Analytic has no words; use estimator=sds"):
        FitGaussians(Analytic(), estimator=estimator)


@pytest.mark.parametrize("wrong", [{"delta": 0.0}, {"step": 1.0}, {"start": -0.1}])
def test_impossible_intervals_are_refused(wrong):
    with pytest.raises(ValueError, match="50 of 1000 steps"):
        ISM(**wrong)


def test_ism_needs_a_time_after_its_start():
    prior, z, noise, cond, t = case()
    with pytest.raises(ValueError, match="raise t_min"):
        ISM(start=0.5)(prior, z, cond, t=t, noise=noise)


# ---------------------------------------------------------------------- the real classes
def plain(folder, texts, prediction, estimator, image, noise, cfg):
    """∂L/∂image for k = 300 and 700, from the checkpoint's networks called by hand and automatic differentiation."""
    from diffusers import AutoencoderKL, DDIMScheduler, UNet2DConditionModel
    from transformers import CLIPTextModel, CLIPTokenizer

    unet = UNet2DConditionModel.from_pretrained(folder, subfolder="unet")
    vae = AutoencoderKL.from_pretrained(folder, subfolder="vae")
    tokenizer = CLIPTokenizer.from_pretrained(folder, subfolder="tokenizer")
    text = CLIPTextModel.from_pretrained(folder, subfolder="text_encoder")
    bar = DDIMScheduler.from_pretrained(folder, subfolder="scheduler").alphas_cumprod

    def embed(words):
        return text(tokenizer(words, padding="max_length", max_length=77, return_tensors="pt").input_ids)[0]

    def at(k):
        a = bar[torch.tensor(k)].view(-1, 1, 1, 1)
        return a.sqrt(), (1 - a).sqrt()

    def answer(z, k, words):
        a, s = at(k)
        out = unet(z, torch.tensor(k), embed(words)).sample
        return out if prediction == "epsilon" else a * out + s * z

    x = image.clone().requires_grad_()
    z = vae.encode(2 * x.permute(0, 3, 1, 2) - 1).latent_dist.mean * vae.config.scaling_factor
    (a, s), negative, empty = at([300, 700]), ["ugly"] * 2, [""] * 2
    with torch.no_grad():
        if estimator == "ism":
            (a0, s0), e = at([0, 0]), None
            z_t = a0 * z + s0 * noise
            path = [([0, 0], [200, 200]), ([200, 200], [250, 400]), ([250, 400], [250, 600]), ([250, 600], [250, 650])]
            for k, to in [*path, ([250, 650], [300, 700])]:
                e = answer(z_t, k, empty)
                (a1, s1), (a2, s2) = at(k), at(to)
                z_t = a2 * (z_t - s1 * e) / a1 + s2 * e
        else:
            z_t, e = a * z + s * noise, noise
        positive, negative = answer(z_t, [300, 700], texts), answer(z_t, [300, 700], negative)
        guided = positive - negative if estimator == "csd" else negative + cfg * (positive - negative) - e
    z.backward(s / a * guided)
    return x.grad


@pytest.mark.parametrize("prediction", ["epsilon", "v_prediction"])
@pytest.mark.parametrize("estimator", [SDS(), CSD(), ISM()], ids=["sds", "csd", "ism"])
def test_gradient_is_that_of_the_formula_written_out(checkpoints, estimator, prediction):
    """∂L/∂image = Jᵀ_VAE (σ/α) r, to 1e-5 of its largest entry in float32."""
    from diffuphy.losses.guidance.stable_diffusion import StableDiffusion

    folder = checkpoints / f"sd-{prediction}"
    prior = StableDiffusion(model=str(folder), size=64, dtype="float32", cfg=7.5, local_files_only=True)
    g = torch.Generator().manual_seed(0)
    image, noise = torch.rand(2, 64, 64, 3, generator=g), torch.randn(2, 4, 8, 8, generator=g)
    camera = orbit([0.0, 180.0], 0.0, 3.0, width=64, height=64)
    cond = prior.condition(Look("burger", "a burger", negative="ugly"), camera, torch.ones(3))
    x = image.clone().requires_grad_()
    sds(prior, x, cond, t=torch.tensor([0.3005, 0.7005]), noise=noise, weight="x0", estimator=estimator).backward()
    texts = ["a burger, front view", "a burger, back view"]
    expected = plain(folder, texts, prediction, type(estimator).__name__.lower(), image, noise, 7.5)
    torch.testing.assert_close(x.grad, expected, rtol=0, atol=1e-5 * expected.abs().max().item())
