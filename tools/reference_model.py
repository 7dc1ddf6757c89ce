"""The paper's self-model in PyTorch: what the benchmark times and the fixtures take their gradients from.

Written from the paper's equations, apart from the Rust code. Tensors are batch × features; weights are out × in.
"""

from dataclasses import dataclass

import torch
from torch import nn
from torch.nn.functional import binary_cross_entropy_with_logits, elu, softplus

LEAST_DEVIATION = 1e-4  # nn: SMALLEST_DEVIATION
RANGE_M = 40.0
AZIMUTHS, BANDS, EGO = 36, 3, 5


@dataclass(frozen=True)
class Sizes:
    visual: int
    visual_mask: int
    verbal: int
    verbal_mask: int
    action: int
    latent: int
    transition_hidden: int
    encoder_hidden: int
    decoder_hidden: int
    visual_deviation: float = 0.1
    verbal_deviation: float = 0.5
    reward_deviation: float = 0.5

    @property
    def encoded(self):
        return self.visual + self.visual_mask + self.verbal + self.verbal_mask


# Paper, appendix, "CARLA" and "Gridworld Driving". The gridworld's observations: ego lane and four positions; position
# and speed symbols for four directions; a mask for each car and modality.
HIGHWAY = Sizes(113, 36, 120, 6, 2, 128, 128, 128, 128)
GRIDWORLD = Sizes(5, 4, 8, 4, 2, 48, 32, 64, 32)


class Mlp(nn.Module):
    """Dense layers with ELU between them and nothing after the last: "3 FC layers" are three of these."""

    def __init__(self, *sizes):
        super().__init__()
        self.layers = nn.ModuleList(nn.Linear(a, b) for a, b in zip(sizes, sizes[1:]))

    def forward(self, x):
        for layer in self.layers[:-1]:
            x = elu(layer(x))
        return self.layers[-1](x)


def gaussian(output):
    mean, raw = output.chunk(2, dim=-1)
    return mean, softplus(raw).clamp(min=LEAST_DEVIATION)


def gaussian_from(z, output):
    """As `gaussian`, where the network gives how far the mean is from `z`: ours, not the paper's."""
    change, deviation = gaussian(output)
    return z + change, deviation


def unlikely(odds, ended):
    """−log p(e | z), summed over features."""
    return binary_cross_entropy_with_logits(odds, ended, reduction="none").sum(-1)


def sample(mean, deviation):
    return torch.addcmul(mean, deviation, torch.randn_like(mean))


class SelfModel(nn.Module):
    def __init__(self, s: Sizes, critic_hidden: int | None = None):
        super().__init__()
        self.sizes = s
        t, e, d = s.transition_hidden, s.encoder_hidden, s.decoder_hidden
        self.transition = Mlp(s.latent + s.action, t, t, 2 * s.latent)
        self.first = Mlp(s.encoded, e, e, 2 * s.latent)
        self.encoder = Mlp(s.latent + s.action + s.encoded, e, e, 2 * s.latent)
        self.visual = Mlp(s.latent, d, d, s.visual)
        self.verbal = Mlp(s.latent, d, d, s.verbal)
        self.reward = Mlp(s.latent, d, d, 1)
        self.ended = Mlp(s.latent, d, d, 1)
        self.policy = Mlp(s.latent, d, d, 2 * s.action)
        if critic_hidden:
            c = critic_hidden
            self.critic_1 = Mlp(s.latent + s.action, c, c, 1)
            self.critic_2 = Mlp(s.latent + s.action, c, c, 1)

    def filter(self, z, action, observed):
        """q_φ(z_t | z_{t−1}, a_{t−1}, x_t), paper equation 4; `z` is None at the first step."""
        if z is None:
            return gaussian(self.first(observed))
        return gaussian_from(z, self.encoder(torch.cat([z, action, observed], dim=-1)))

    def advance(self, z, action):
        """p_θ(z_t | z_{t−1}, a_{t−1})."""
        return gaussian_from(z, self.transition(torch.cat([z, action], dim=-1)))

    def negative_elbo(self, steps):
        """−L_e of paper equation 3 per step, averaged over the batch; constants of fixed deviations left out.

        `steps`: dicts with observed, visual, verbal, action, reward, ended, noise. Returns loss and its four terms.
        """
        s, z = self.sizes, None
        reconstruction = reward = ending = divergence = 0.0
        for x in steps:
            mean, deviation = self.filter(z, x["action"], x["observed"])
            if z is None:
                prior_mean, prior_deviation = torch.zeros_like(mean), torch.ones_like(deviation)
            else:
                prior_mean, prior_deviation = self.advance(z, x["action"])
            z = mean + deviation * x["noise"]
            kl = (prior_deviation / deviation).log() - 0.5
            kl = kl + (deviation**2 + (mean - prior_mean) ** 2) / (2 * prior_deviation**2)
            divergence = divergence + kl.sum(-1).mean()
            for decoder, target, sigma in (
                (self.visual, x["visual"], s.visual_deviation),
                (self.verbal, x["verbal"], s.verbal_deviation),
            ):
                error = (decoder(z) - target) ** 2 / (2 * sigma**2)
                reconstruction = reconstruction + error.sum(-1).mean()
            error = (self.reward(z) - x["reward"]) ** 2 / (2 * s.reward_deviation**2)
            reward = reward + error.sum(-1).mean()
            ending = ending + unlikely(self.ended(z), x["ended"]).mean()
        terms = [term / len(steps) for term in (reconstruction, reward, ending, divergence)]
        return sum(terms), *terms

    def foresight(self, steps, start):
        """How badly the steps after `start` are foreseen, from z there, given the actions alone; per step, averaged over the batch."""
        s, z, loss = self.sizes, None, 0.0
        for i, x in enumerate(steps):
            if i <= start:
                mean, deviation = self.filter(z, x["action"], x["observed"])
            else:
                mean, deviation = self.advance(z, x["action"])
            if i <= start:
                z = mean + deviation * x["noise"]
                continue
            z = mean
            for decoder, target, sigma in (
                (self.visual, x["visual"], s.visual_deviation),
                (self.verbal, x["verbal"], s.verbal_deviation),
                (self.reward, x["reward"], s.reward_deviation),
            ):
                error = (decoder(z) - target) ** 2 / (2 * sigma**2)
                loss = loss + error.sum(-1).mean() / (len(steps) - 1 - start)
            loss = loss + unlikely(self.ended(z), x["ended"]).mean() / (len(steps) - 1 - start)
        return loss


def random_steps(sizes: Sizes, batch: int, count: int, generator=None):
    """Sequences of plausible values, for timing."""
    def uniform(n):
        return torch.rand(batch, n, generator=generator)

    out = []
    for _ in range(count):
        visual, verbal = uniform(sizes.visual), uniform(sizes.verbal)
        masks = [(uniform(n) < 0.35).float() for n in (sizes.visual_mask, sizes.verbal_mask)]
        noise = torch.randn(batch, sizes.latent, generator=generator)
        out.append(
            dict(
                observed=torch.cat([visual, masks[0], verbal, masks[1]], dim=-1),
                visual=visual,
                verbal=verbal,
                action=2 * uniform(sizes.action) - 1,
                reward=uniform(1),
                ended=(uniform(1) < 0.3).float(),
                noise=noise,
            )
        )
    return out


def nearest_range_m(visual):
    """Range of each azimuth's nearest return in metres, batch × 36, from nearness over the three bands."""
    nearness = visual[:, : AZIMUTHS * BANDS].unflatten(1, (BANDS, AZIMUTHS)).amax(1)
    return RANGE_M * (1 - nearness.clamp(0, 1))
