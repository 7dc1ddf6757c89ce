#!/usr/bin/env python3
"""The PyTorch column of docs/benchmarks.md: the same work as our benchmarks, in eager PyTorch, on the machine at hand.

    /tmp/venv/bin/python tools/pytorch_bench.py                        # all rows, 2 threads
    /tmp/venv/bin/python tools/pytorch_bench.py --only highway_plan --repeats 100

One JSON object a line: median, p99 and max in milliseconds over all repeats after warming up. Nothing is filtered.
"""

import argparse
import json
import os
import time

import torch

from reference_model import AZIMUTHS, BANDS, GRIDWORLD, HIGHWAY, SelfModel, gaussian, nearest_range_m, random_steps, sample

SAMPLES, ITERATIONS, ELITES, HORIZON, REPEAT = 1000, 3, 200, 4, 2  # the highway's defaults: horizon 4 × 2 steps
SECTOR_OF = torch.tensor([0] + [1] * 9 + [2] * 8 + [3] + [4] * 8 + [5] * 9)
ON_DISPLAY = torch.tensor([float(a <= 9 or a >= 27) for a in range(AZIMUTHS)])


def highway_plan():
    """Forward imagination inside the cross-entropy method: 1000 samples × 3 iterations × 8 steps, all seven steps."""
    torch.manual_seed(0)
    model = SelfModel(HIGHWAY).eval()
    # Implants: limits of sight in metres, and a residual that is linear in 12 directions of z within ±2.5.
    limit = torch.full((AZIMUTHS,), 20.5)
    directions, residual = torch.randn(HIGHWAY.latent, 12), torch.zeros(12, HIGHWAY.action)
    beams = AZIMUTHS * BANDS
    belief_r = gaussian(torch.randn(1, 256))
    belief_h = gaussian(torch.randn(1, 256))
    discount = 0.9 ** torch.arange(HORIZON * REPEAT)

    @torch.inference_mode()
    def plan():
        probability = torch.full((HORIZON, 12), 0.35)
        for _ in range(ITERATIONS):
            bits = (torch.rand(SAMPLES, HORIZON, 12) < probability).float()
            z_r = sample(*(t.expand(SAMPLES, -1) for t in belief_r))
            z_h = sample(*(t.expand(SAMPLES, -1) for t in belief_h))
            value, going = torch.zeros(SAMPLES), torch.ones(SAMPLES)
            for step in range(HORIZON * REPEAT):
                shown = bits[:, step // REPEAT]
                # 1 the person's action; 2 the world's step
                mean, deviation = gaussian(model.policy(z_h))
                action = sample(mean + (z_h @ directions).clamp(-2.5, 2.5) @ residual, deviation).tanh()
                z_r = sample(*model.advance(z_r, action))
                # 3 observations and reward
                visual, verbal, reward = model.visual(z_r), model.verbal(z_r), model.reward(z_r)
                # 4 what the person sees; 5 what is communicated; 6 both
                range_m = nearest_range_m(visual)
                mask = (range_m <= limit).float()
                boxes = shown[:, :6][:, SECTOR_OF] * ON_DISPLAY * (range_m < 38.0)
                mask = torch.maximum(mask, boxes)
                heard = shown[:, 6:]
                spoken = verbal * heard.repeat_interleave(20, dim=1)
                seen = visual[:, :beams] * mask.repeat(1, BANDS)
                # 7 the person's belief
                z_h = sample(*model.filter(z_h, action, torch.cat([seen, visual[:, beams:], mask, spoken, heard], dim=-1)))
                visual_cost = 0.02 * (shown[:, :6] * torch.tensor([1.0, 9.0, 0.0, 0.0, 0.0, 9.0])).sum(1)
                cost = visual_cost + 0.4 * heard.sum(1) ** 3
                value += discount[step] * (10.0 * going * reward[:, 0] - cost)
                going = going * (1 - model.ended(z_r)[:, 0].sigmoid())
            elite = value.topk(ELITES).indices
            probability = 0.2 * probability + 0.8 * bits[elite].mean(0)
        return probability

    return plan


def elbo_step(sizes, batch, count):
    def make():
        torch.manual_seed(0)
        model = SelfModel(sizes)
        optimiser = torch.optim.Adam(model.parameters(), lr=3e-4)
        steps = random_steps(sizes, batch, count)

        def step():
            for x in steps:
                x["noise"] = torch.randn(batch, sizes.latent)
            loss = model.negative_elbo(steps)[0]
            optimiser.zero_grad(set_to_none=True)
            loss.backward()
            optimiser.step()

        return step

    return make


ROWS = dict(
    highway_plan=(highway_plan, 60),
    gridworld_elbo_step=(elbo_step(GRIDWORLD, 32, 16), 400),
    highway_elbo_step=(elbo_step(HIGHWAY, 200, 3), 400),
)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--only", choices=ROWS)
    parser.add_argument("--repeats", type=int, help="instead of each row's own number")
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    for name, (make, repeats) in ROWS.items():
        if arguments.only not in (None, name):
            continue
        work, load = make(), os.getloadavg()[0]
        for _ in range(5):
            work()
        times = []
        for _ in range(arguments.repeats or repeats):
            start = time.perf_counter()
            work()
            times.append((time.perf_counter() - start) * 1e3)
        times.sort()
        at = lambda q: round(times[min(len(times) - 1, int(q * len(times)))], 3)
        print(
            json.dumps(
                dict(
                    work=name,
                    median_ms=at(0.5),
                    p99_ms=at(0.99),
                    max_ms=round(times[-1], 3),
                    min_ms=round(times[0], 3),
                    repeats=len(times),
                    threads=arguments.threads,
                    torch=torch.__version__,
                    load_before=round(load, 2),
                )
            ),
            flush=True,
        )


if __name__ == "__main__":
    main()
