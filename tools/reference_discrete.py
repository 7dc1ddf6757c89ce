"""The paper's gridworld self-models in PyTorch: states, or images with words. Written from the paper's equations and PyTorch's own
convolutions, apart from the Rust code. Tensors are batch × features; images are channel after channel, row after row.
"""

from dataclasses import dataclass

import torch
from torch import nn
from torch.nn.functional import elu

from reference_model import Mlp, gaussian, gaussian_from, unlikely


@dataclass(frozen=True)
class Image:
    colours: int
    height: int
    width: int
    kernel: int
    stride: int
    channels: int
    patterns: int
    hidden: int
    features: int

    @property
    def numbers(self):
        return self.colours * self.height * self.width

    @property
    def grid(self):
        return [(side - self.kernel) // self.stride + 1 for side in (self.height, self.width)]


@dataclass(frozen=True)
class Sizes:
    visual: int
    regions: int
    verbal: int
    utterances: int
    actions: int
    image: Image | None
    latent: int = 48
    transition_hidden: int = 32
    encoder_hidden: int = 64
    decoder_hidden: int = 32
    q_hidden: int = 128
    image_deviation: float = 0.3
    state_deviation: float = 0.04
    verbal_deviation: float = 0.2
    reward_deviation: float = 0.5

    @property
    def encoded(self):
        return self.visual + self.regions + self.verbal + self.utterances


class DiscreteModel(nn.Module):
    def __init__(self, s: Sizes):
        super().__init__()
        self.sizes = s
        t, e, d, q = s.transition_hidden, s.encoder_hidden, s.decoder_hidden, s.q_hidden
        features = 2 * s.image.features if s.image else s.encoded
        pixels = s.image.numbers if s.image else 0
        down, across = s.image.grid if s.image else (0, 0)
        places, drawn = (down * across * n for n in ((s.image.channels, s.image.patterns) if s.image else (0, 0)))
        self.transition = Mlp(s.latent + s.actions, t, t, 2 * s.latent)
        self.first = Mlp(features, e, e, 2 * s.latent)
        self.encoder = Mlp(s.latent + s.actions + features, e, e, 2 * s.latent)
        self.visual = Mlp(s.latent, d, d, drawn + s.visual - pixels)
        self.verbal = Mlp(s.latent, d, d, s.verbal)
        self.reward = Mlp(s.latent, d, d, 1)
        self.ended = Mlp(s.latent, d, d, 1)
        self.q = Mlp(s.latent, q, q, s.actions)
        if s.image:
            i = s.image
            self.conv = nn.Conv2d(i.colours, i.channels, i.kernel, i.stride)
            self.look = Mlp(places + s.visual - pixels + s.regions, i.hidden, i.hidden, i.features)
            self.listen = nn.Linear(s.verbal + s.utterances, i.features)
            self.draw = nn.ConvTranspose2d(i.patterns, i.colours, i.kernel, i.stride)

    def read(self, observed):
        s = self.sizes
        if not s.image:
            return observed
        i, seen = s.image, s.visual + s.regions
        image = observed[:, : i.numbers].reshape(-1, i.colours, i.height, i.width)
        # A feature map lies place after place, channels nearest.
        places = elu(self.conv(image)).permute(0, 2, 3, 1).flatten(1)
        looked = elu(self.look(torch.cat([places, observed[:, i.numbers : seen]], dim=-1)))
        return torch.cat([looked, elu(self.listen(observed[:, seen:]))], dim=-1)

    def posterior(self, z, action, features):
        if z is None:
            return gaussian(self.first(features))
        return gaussian_from(z, self.encoder(torch.cat([z, action, features], dim=-1)))

    def decode(self, z):
        output = self.visual(z)
        i = self.sizes.image
        if not i:
            return output
        down, across = i.grid
        drawn = down * across * i.patterns
        map_ = elu(output[:, :drawn]).reshape(-1, down, across, i.patterns).permute(0, 3, 1, 2)
        return torch.cat([self.draw(map_).flatten(1), output[:, drawn:]], dim=-1)

    def negative_elbo(self, steps):
        """−L_e of paper equation 3 per step that counts; `weight` is 0 beyond an episode's end."""
        s, z = self.sizes, None
        pixels = s.image.numbers if s.image else 0
        reconstruction = reward = ending = divergence = counted = 0.0
        for x in steps:
            weight = x["weight"][:, 0]
            mean, deviation = self.posterior(z, x["action"], self.read(x["observed"]))
            if z is None:
                prior_mean, prior_deviation = torch.zeros_like(mean), torch.ones_like(deviation)
            else:
                prior_mean, prior_deviation = gaussian_from(z, self.transition(torch.cat([z, x["action"]], dim=-1)))
            z = mean + deviation * x["noise"]
            kl = torch.distributions.kl_divergence(
                torch.distributions.Normal(mean, deviation), torch.distributions.Normal(prior_mean, prior_deviation)
            )
            divergence = divergence + (weight * kl.sum(-1)).sum()
            error = (self.decode(z) - x["visual"]) ** 2
            visual = error[:, :pixels].sum(-1) / (2 * s.image_deviation**2)
            visual = visual + error[:, pixels:].sum(-1) / (2 * s.state_deviation**2)
            verbal = ((self.verbal(z) - x["verbal"]) ** 2).sum(-1) / (2 * s.verbal_deviation**2)
            reconstruction = reconstruction + (weight * (visual + verbal)).sum()
            error = ((self.reward(z) - x["reward"]) ** 2)[:, 0] / (2 * s.reward_deviation**2)
            reward = reward + (weight * error).sum()
            ending = ending + (weight * unlikely(self.ended(z), x["ended"])).sum()
            counted = counted + weight.sum()
        terms = [term / counted for term in (reconstruction, reward, ending, divergence)]
        return sum(terms), *terms
