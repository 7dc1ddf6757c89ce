#!/usr/bin/env python3
"""Makes tools/fixtures/: one ELBO step and one look ahead with the losses and gradients that PyTorch's autograd finds.

    /tmp/venv/bin/python tools/make_fixtures.py                     # small networks; these files ship with the tests
    /tmp/venv/bin/python tools/make_fixtures.py --paper-sizes --out D    # the same at the paper's sizes
    /tmp/venv/bin/python tools/make_fixtures.py --checkpoint F --out D   # the same on a trained model of ours

Each file holds weights and inputs (float32) and what must come out, computed in float64 from those float32 numbers:

    weight.<parameter>     outputs × inputs
    input.<step>.<name>    features × batch
    expected.<term>        a single number
    gradient.<parameter>   as the weight

They are checkpoints in our own layout (nn::checkpoint), so that the tests read them with the code that reads models.

The mathematics is the paper's, written in reference_model.py apart from the Rust code.
"""

import argparse
import json
import sys
from pathlib import Path

import numpy as np
import torch

import tensor_file
from reference_model import HIGHWAY, SelfModel, Sizes, random_steps

ROOT = Path(__file__).resolve().parent.parent
# Small enough to ship, and no two sizes equal, so that a mistaken axis cannot go unnoticed. The modalities are the
# highway's. One size serves all hidden layers, as in the Rust model.
SMALL = Sizes(113, 36, 120, 6, 2, latent=12, transition_hidden=17, encoder_hidden=17, decoder_hidden=17)


def rust_name(name):
    """`transition.layers.0.weight` here is `transition.0.weight` there."""
    return name.replace(".layers.", ".")


def with_weights(tensors, model, prefix=""):
    for name, parameter in model.named_parameters():
        tensors[f"weight.{prefix}{rust_name(name)}"] = parameter.detach().float().numpy()
    # The rewards that were ever earned: a part of the file, in no term of the loss.
    tensors[f"weight.{prefix}rewards"] = np.array([-7.0, 5.0], dtype=np.float32)


def with_gradients(tensors, model, prefix=""):
    for name, parameter in model.named_parameters():
        if parameter.grad is not None:
            tensors[f"gradient.{prefix}{rust_name(name)}"] = parameter.grad.float().numpy()


def with_terms(tensors, **terms):
    for name, value in terms.items():
        tensors[f"expected.{name}"] = np.array([value.item()], dtype=np.float32)


def with_inputs(tensors, steps):
    for i, step in enumerate(steps):
        for name, value in step.items():
            tensors[f"input.{i}.{name}"] = value.float().numpy().T


def float32_exact(module):
    """Rounds to what the file will hold, then computes on in float64."""
    module.float()
    return module.double()


def lidar_like(batch, generator):
    """Visual modality: nearness with empty azimuths among near ones, and ego values of either sign; batch × 113."""
    near = torch.rand(batch, 36, generator=generator) * (torch.rand(batch, 36, generator=generator) < 0.6)
    bands = [near * scale for scale in (0.9, 1.0, 0.7)]
    ego = 2 * torch.rand(batch, 5, generator=generator) - 1
    return torch.cat([*bands, ego], dim=-1)


def sequence(sizes, batch, count, generator):
    """Steps of a batch, seen through random masks."""
    steps = random_steps(sizes, batch, count, generator)
    for step in steps:
        step["visual"] = lidar_like(batch, generator)
        visual_mask = (torch.rand(batch, 36, generator=generator) < 0.35).float()
        verbal_mask = (torch.rand(batch, 6, generator=generator) < 0.35).float()
        masks = torch.cat([visual_mask.repeat(1, 3), torch.ones(batch, 5)], dim=-1)
        seen, heard = step["visual"] * masks, step["verbal"] * verbal_mask.repeat_interleave(20, dim=1)
        step["observed"] = torch.cat([seen, visual_mask, heard, verbal_mask], dim=-1)
        step["reward"] = torch.randn(batch, 1, generator=generator)
        step["ended"] = (torch.rand(batch, 1, generator=generator) < 0.3).float()
    steps[0]["action"].zero_()
    return steps


def double(steps):
    return [{name: value.float().double() for name, value in step.items()} for step in steps]


def elbo_fixture(sizes, model, generator):
    batch, count = 7, 3
    steps = sequence(sizes, batch, count, generator)
    tensors = {}
    with_weights(tensors, model)
    with_inputs(tensors, steps)
    model.zero_grad(set_to_none=True)
    loss, reconstruction, reward, ending, divergence = model.negative_elbo(double(steps))
    loss.backward()
    with_gradients(tensors, model)
    with_terms(tensors, loss=loss, reconstruction=reconstruction, reward=reward, ending=ending, divergence=divergence)
    return tensors, dict(batch=batch, steps=count)


def foresight_fixture(sizes, model, generator):
    """The loss of what is imagined open loop, from the second step of five."""
    batch, count, start = 7, 5, 1
    steps = sequence(sizes, batch, count, generator)
    tensors = {}
    with_weights(tensors, model)
    with_inputs(tensors, steps)
    model.zero_grad(set_to_none=True)
    loss = model.foresight(double(steps), start)
    loss.backward()
    with_gradients(tensors, model)
    with_terms(tensors, loss=loss)
    return tensors, dict(batch=batch, steps=count, start=start)


def load(checkpoint):
    """Our checkpoint's self-model, by the names in it."""
    from safetensors.numpy import load_file

    stored = load_file(checkpoint)
    model = SelfModel(HIGHWAY, critic_hidden=128)
    with torch.no_grad():
        for name, parameter in model.named_parameters():
            found = [key for key in stored if key == rust_name(name) or key.endswith("." + rust_name(name))]
            if len(found) != 1:
                sys.exit(f"{checkpoint}: no single tensor is named {rust_name(name)}: {found}")
            value = torch.from_numpy(stored[found[0]])
            parameter.copy_(value.reshape(parameter.shape))
    return HIGHWAY, model


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--checkpoint", type=Path, help="take the weights from a trained highway self-model")
    parser.add_argument("--paper-sizes", action="store_true", help="random weights of the paper's sizes: too large to ship")
    parser.add_argument("--out", type=Path, default=ROOT / "tools/fixtures")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    torch.manual_seed(arguments.seed)
    generator = torch.Generator().manual_seed(arguments.seed)
    if arguments.checkpoint:
        sizes, model = load(arguments.checkpoint)
    else:
        sizes = HIGHWAY if arguments.paper_sizes else SMALL
        model = SelfModel(sizes, critic_hidden=sizes.encoder_hidden)
        with torch.no_grad():  # one dimension of q_φ lies on the deviations' floor, where no gradient passes
            for network in (model.first, model.encoder):
                network.layers[-1].bias[sizes.latent + 3] = -14
    model = float32_exact(model)
    for name, make in (("elbo_step", elbo_fixture), ("foresight", foresight_fixture)):
        tensors, numbers = make(sizes, model, generator)
        metadata = {"mirror.checkpoint": "1"} | dict(
            fixture=name,
            command=f"tools/make_fixtures.py --seed {arguments.seed}",
            torch=torch.__version__.split("+")[0],
            latent=sizes.latent,
            hidden=sizes.encoder_hidden,
            **numbers,
        )
        path = arguments.out / f"{name}.safetensors"
        tensor_file.save(path, tensors, metadata)
        terms = {k.removeprefix("expected."): float(v[0]) for k, v in tensors.items() if k.startswith("expected.")}
        norms = {k: float(np.linalg.norm(v)) for k, v in tensors.items() if k.startswith("gradient.")}
        print(json.dumps(dict(file=str(path), bytes=path.stat().st_size, **terms, gradients=len(norms), least_gradient=min(norms.values()))))


if __name__ == "__main__":
    main()
