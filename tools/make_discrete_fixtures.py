#!/usr/bin/env python3
"""Makes tools/fixtures/elbo_driving and elbo_search_rescue: whole ELBO steps of the gridworlds' self-models, with the loss and the
gradients that PyTorch's autograd finds. Driving's networks have the paper's sizes, the ones with images are smaller, to ship.

    /tmp/venv/bin/python tools/make_discrete_fixtures.py

The layout of the files is that of make_fixtures.py.
"""

import argparse
import json
from dataclasses import replace
from pathlib import Path

import torch

import tensor_file
from make_fixtures import ROOT, float32_exact, with_gradients, with_inputs, with_terms, with_weights
from reference_discrete import DiscreteModel, Image, Sizes

DRIVING = Sizes(visual=5, regions=4, verbal=8, utterances=4, actions=2, image=None)
SEARCH_RESCUE = Sizes(
    visual=246, regions=9, verbal=50, utterances=5, actions=4,
    image=Image(colours=3, height=9, width=9, kernel=3, stride=3, channels=4, patterns=5, hidden=48, features=16),
    latent=11, transition_hidden=13, encoder_hidden=17, decoder_hidden=19, q_hidden=7, state_deviation=0.08,
)  # fmt: skip


def steps_of(sizes, batch, count, generator):
    rand = lambda n: torch.rand(batch, n, generator=generator)
    steps = []
    for t in range(count):
        action = torch.nn.functional.one_hot((rand(1)[:, 0] * sizes.actions).long(), sizes.actions).float()
        weight = torch.ones(batch, 1)
        weight[: t // 2] = 0.0  # some sequences have ended
        steps.append(
            dict(
                # Masks need not fit the domain here: what the model sees is an input.
                observed=(2 * rand(sizes.encoded) - 1) * (rand(sizes.encoded) < 0.6),
                visual=2 * rand(sizes.visual) - 1,
                verbal=2 * rand(sizes.verbal) - 1,
                action=action if t else torch.zeros_like(action),
                reward=torch.randn(batch, 1, generator=generator),
                ended=(rand(1) < 0.3).float(),
                noise=torch.randn(batch, sizes.latent, generator=generator),
                weight=weight,
            )
        )
    return steps


def ours(tensors):
    """Convolutions' weights as matrices: channels out × (channels in, kernel, kernel), and for the transposed one its transpose."""
    for name in list(tensors):
        kind, _, rest = name.partition(".")
        if kind in ("weight", "gradient") and rest == "conv.weight":
            tensors[name] = tensors[name].reshape(tensors[name].shape[0], -1)
        if kind in ("weight", "gradient") and rest == "draw.weight":
            tensors[name] = tensors[name].reshape(tensors[name].shape[0], -1).T.copy()
    return tensors


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=ROOT / "tools/fixtures")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    for name, sizes, batch, count in (("elbo_driving", DRIVING, 5, 4), ("elbo_search_rescue", SEARCH_RESCUE, 3, 3)):
        torch.manual_seed(arguments.seed)
        generator = torch.Generator().manual_seed(arguments.seed)
        model = float32_exact(DiscreteModel(replace(sizes)))
        steps = steps_of(sizes, batch, count, generator)
        tensors = {}
        with_weights(tensors, model)
        with_inputs(tensors, steps)
        steps = [{key: value.float().double() for key, value in step.items()} for step in steps]
        loss, reconstruction, reward, ending, divergence = model.negative_elbo(steps)
        loss.backward()
        with_gradients(tensors, model)
        with_terms(tensors, loss=loss, reconstruction=reconstruction, reward=reward, ending=ending, divergence=divergence)
        metadata = {"mirror.checkpoint": "1"} | dict(
            fixture=name,
            command=f"tools/make_discrete_fixtures.py --seed {arguments.seed}",
            torch=torch.__version__.split("+")[0],
            batch=batch,
            steps=count,
            latent=sizes.latent,
            transition_hidden=sizes.transition_hidden,
            encoder_hidden=sizes.encoder_hidden,
            decoder_hidden=sizes.decoder_hidden,
            q_hidden=sizes.q_hidden,
        )
        path = arguments.out / f"{name}.safetensors"
        tensor_file.save(path, ours(tensors), metadata)
        print(json.dumps(dict(file=str(path), bytes=path.stat().st_size, loss=loss.item())))


if __name__ == "__main__":
    main()
